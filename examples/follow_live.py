"""Follow a cube live, here in a recording replayed at its own pace."""

import time

import tracker

source = tracker.live.Replay("my_recording")  # or Pushed(): images are pushed into it from any thread
follower = tracker.ObjectTracker("cube_v2", source.log.rig or "tracker-demo")
with tracker.live.Live(source, follower) as live:
    moment = live.wait(after=-1)
    while moment is not None:
        pose = live.at(time.time() + 0.05)  # where the cube will be when the fingers get there
        where = "unknown" if pose is None else f"{pose.position.round(4)} m"
        print(f"{moment.status}, {1e3 * moment.latency:.0f} ms old, in 50 ms at", where)
        moment = live.wait(after=moment)
