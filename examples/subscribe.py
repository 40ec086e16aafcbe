"""Print the poses that `tracker live … --publish tcp://127.0.0.1:5555` sends to other processes."""

import json
import sys

import zmq

socket: zmq.Socket[bytes] = zmq.Context.instance().socket(zmq.SUB)
socket.setsockopt(zmq.CONFLATE, 1)  # only the newest counts
socket.setsockopt_string(zmq.SUBSCRIBE, "")
socket.connect(sys.argv[1] if len(sys.argv) > 1 else "tcp://127.0.0.1:5555")
counts: dict[str, int] = {}
while True:
    message = json.loads(socket.recv())
    print(message["status"], message["pose"] and message["pose"]["position"], flush=True)
    for camera, count in message["fault_counts"].items():
        if count > counts.setdefault(camera, count):  # also in messages that were missed
            reason = message["faults"].get(camera, "usable again")
            print(f"{camera}: faults in {count - counts[camera]} sets: {reason}")
    counts = message["fault_counts"]
