"""Live: cameras in, poses out.

    with tracker.live.Live(source, tracker.ObjectTracker(model, rig)) as live:
        moment = live.wait(timeout=1.0)     # the next pose
        pose = live.at(time.time() + 0.05)  # where the object will be

A source gives sets of images, one per camera: from a replayed recording (`Replay`), from cameras triggered
together (`open_cameras`), from the simulated platform (`Simulation`), or pushed by the caller (`Pushed`).
"""

from tracker.live import platform as platform
from tracker.live.cameras import CameraSet as CameraSet
from tracker.live.live import Live as Live
from tracker.live.moment import ImageSet as ImageSet
from tracker.live.moment import ImageSource as ImageSource
from tracker.live.moment import Moment as Moment
from tracker.live.moment import SourceEnded as SourceEnded
from tracker.live.sources import Pushed as Pushed
from tracker.live.sources import Replay as Replay
from tracker.live.sources import Simulation as Simulation
from tracker.live.sources import open_cameras as open_cameras
