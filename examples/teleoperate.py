"""Sends the targets of a recorded motion to `crar-drake serve`, and hears what it says.

    crar-drake serve &
    python examples/teleoperate.py --motion dance --rate 60

It stands for a headset or a camera that tracks a person. With `--trouble 0.1` a tenth
of what it sends is nonsense and a tenth is lost, as a load test. At the end it tells
how long answers took and, from the positions that came back, judges the robot's motion
by means of its own.
"""

import argparse
import json
import random
import socket
import threading
import time

import numpy as np

from crar_drake.judging.referee import Referee
from crar_drake.simulation.diagram import PrepareScenario
from crar_drake.simulation.scenario import load_scenario

NONSENSE = (
    b"",
    b"\x00\xff" * 40,
    b'{"targets": {"left_wrist": {"position": [1, 2]}}}',
    b'{"targets": {"left_wrist": {"position": [NaN, 0, 0]}}}',
    b'{"targets": {"__class__": {"position": [0, 0, 0]}}}',
    b"[" * 8000,
    b"7" * 20000,
)

PATIENCE = 60.0  # [s] for a server that has yet to compile


class Client:
    """A socket that sends targets, and a thread that keeps the answers."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect((host, port))
        self._socket.settimeout(2.0)
        self.sent: dict[float, float] = {}  # time stamp to when it was sent [s]
        self.round_trips: list[float] = []  # [s]
        self.positions: list[list[float]] = []
        self.status: dict[str, int] = {}
        self.description = self._describe()
        self._stop = False
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def send(self, at: float, targets: dict[str, dict]) -> None:
        self.sent[at] = time.monotonic()
        self.send_bytes(json.dumps({"time": at, "targets": targets}).encode())

    def send_bytes(self, data: bytes) -> None:
        try:
            self._socket.send(data)
        except OSError:  # a full buffer: lost, as on any network
            pass

    def close(self) -> None:
        self._stop = True
        self._thread.join()
        self._socket.close()

    def _describe(self) -> dict:
        until = time.monotonic() + PATIENCE
        while time.monotonic() < until:
            try:
                self._socket.send(b'{"describe": true}')
                said = json.loads(self._socket.recv(65536))
                if "tasks" in said:
                    return said
            except ConnectionRefusedError:
                time.sleep(0.2)  # it may still be starting
            except TimeoutError:
                pass  # it compiles, or the message was lost: ask once more
        raise SystemExit("nobody answers: is crar-drake serve running?")

    def _listen(self) -> None:
        while not self._stop:
            try:
                said = json.loads(self._socket.recv(65536))
            except OSError:
                continue
            if "positions" not in said:
                continue
            self.status[said["status"]] = self.status.get(said["status"], 0) + 1
            self.positions.append(said["positions"])
            sent = self.sent.pop(said["of"], None) if said["of"] is not None else None
            if sent is not None:
                self.round_trips.append(time.monotonic() - sent)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=7670)
    parser.add_argument("--scenario", default="dance_wrists", help="as the server's")
    parser.add_argument("--motion", help="instead of the scenario's")
    parser.add_argument("--rate", type=float, default=60.0, help="targets per second")
    parser.add_argument("--duration", type=float, help="seconds; the motion repeats")
    parser.add_argument("--trouble", type=float, default=0.0, help="share, see above")
    parser.add_argument("--judge-every", type=int, default=10, help="commands")
    options = parser.parse_args()

    scenario = load_scenario(options.scenario)
    scenario.motion = options.motion or scenario.motion
    setup = PrepareScenario(scenario)
    layout, motion = setup.model.layout, setup.motion
    client = Client(options.host, options.port)
    print(f"{client.description['robot']}: {', '.join(client.description['tasks'])}")

    rng = random.Random(0)
    start, number = time.monotonic(), 0
    while (at := number / options.rate) < (options.duration or motion.duration):
        desired = layout.unpack(motion.tasks_at(at % motion.duration))
        targets = {
            layout.names[task]: {"position": desired.p[i].tolist()}
            for i, task in enumerate(layout.linear_tasks)
        }
        if rng.random() < options.trouble:
            client.send_bytes(rng.choice(NONSENSE))
        if rng.random() >= options.trouble:
            client.send(at, targets)
        number += 1
        time.sleep(max(0.0, start + number / options.rate - time.monotonic()))
    client.close()

    times = 1e3 * np.array(client.round_trips)
    print(f"{number} targets, {len(client.positions)} commands: {client.status}")
    if len(times):
        p50, p99 = np.percentile(times, [50, 99])
        print(f"from target to answer: p50 {p50:.2f} ms, p99 {p99:.2f} ms")
    model = setup.model
    judged = Referee(model.plant, model.scene_graph, model.description.pairs)
    found = judged.violations(np.array(client.positions)[:: options.judge_every])
    print(
        f"{found.num_violated} of {found.num_samples} positions in violation, smallest "
        f"distance {1e3 * found.smallest_distance:.1f} mm"
    )


if __name__ == "__main__":
    main()
