"""Live: cameras in, poses out.

    with tracker.live.Live(source, tracker.ObjectTracker(model, rig)) as live:
        moment = live.wait(timeout=1.0)     # the next pose
        pose = live.at(time.time() + 0.05)  # where the object will be

A source gives sets of images, one for each camera: a recording replayed (`Replay`), cameras asked together
(`open_cameras`), the simulated platform (`Simulation`), or images that the caller pushes (`Pushed`).
"""

from tracker.live.camera_set import CameraSet as CameraSet
from tracker.live.live import Live as Live
from tracker.live.moment import Moment as Moment
from tracker.live.opening import open_cameras as open_cameras
from tracker.live.pushed import Pushed as Pushed
from tracker.live.replay import Replay as Replay
from tracker.live.shot import Shot as Shot
from tracker.live.shot import Source as Source
from tracker.live.shot import SourceEnded as SourceEnded
from tracker.live.simulation import Simulation as Simulation
