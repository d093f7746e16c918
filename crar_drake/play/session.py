"""The loop of `crar-drake play`: real time, requests, pictures, and what is left."""

import gc
import queue
import time
from collections.abc import Callable
from ctypes import py_object, pythonapi
from pathlib import Path

import numpy as np
from pydrake.geometry import Meshcat, MeshcatParams

from crar_drake.errors import CrarError
from crar_drake.interrupts import Interrupts
from crar_drake.law.compilation import when_compiling
from crar_drake.motion.report import inspect
from crar_drake.play.live_scene import LiveScene
from crar_drake.play.live_simulation import LiveSimulation
from crar_drake.play.pacing import Pacer
from crar_drake.play.page import make_page, viewer_script
from crar_drake.play.requests import Request
from crar_drake.play.web_server import PlayServer
from crar_drake.run import RunResult, finish, with_lasting_name
from crar_drake.simulation.scenario import Scenario

_FRAME = 1.0 / 30.0  # [s]
_IDLE = 0.02  # that a wait lasts at most: Ctrl-C is looked at in between [s]
_NOTICE = 6.0  # that a notice stays [s]


class PlaySession:
    """A live simulation, its page, and the loop that moves both.

    It belongs to the thread that makes it: Meshcat must be destroyed by that thread.

    Attributes:
        live: the simulation.
        pacer: how it goes with the clock.
        url: of the page.
        failure: what stopped the simulation; None if nothing did.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        speed: float = 1.0,
        tell: Callable[[str], None] = lambda text: None,
    ) -> None:
        """
        Args:
            scenario: validated.
            host, port: of the page, see `PlayServer`; Meshcat takes a port of its own.
            speed: simulated seconds in a real one.
            tell: is called with a sentence when the control law has to be compiled.

        Raises:
            CrarError: something in the scenario, its robot or its motion is wrong, or
                nothing can listen there.
        """
        # What takes no time to find out comes first.
        self._server = PlayServer(host, port)
        self._meshcat: Meshcat | None = None
        try:
            with when_compiling(tell):
                self.live = LiveSimulation(scenario)
                self.live.compile()
            self._meshcat = _make_meshcat(host)
            self._scene = LiveScene(self.live, self._meshcat)
            page = make_page(self.live, self._scene, self._meshcat.port())
        except BaseException:
            self.close()
            raise
        self._server.start(page, viewer_script())
        self.url = self._server.url
        self.pacer = Pacer(time.monotonic(), speed=speed)
        self.failure: BaseException | None = None
        self._stopped = False
        self._notice, self._notice_until = "", 0.0
        self._drawn = -np.inf

    def run(self, interrupts: Interrupts, duration: float | None = None) -> None:
        """Goes on until somebody stops it; what stops the simulation is `failure`.

        Args:
            interrupts: held; the first ends the loop between two steps.
            duration: ends it at that simulated time, too [s].
        """
        gc.collect()
        gc.freeze()  # else each of the collector's rounds would be a pause
        live, pacer = self.live, self.pacer
        pacer.set_paused(pacer.paused, time.monotonic(), live.time)
        try:
            while not self._stopped:
                if interrupts.asked:
                    break
                if duration is not None and live.time >= duration - 1e-9:
                    break
                now = time.monotonic()
                wait = _IDLE if pacer.paused else pacer.wait(now, live.time)
                if now - self._drawn >= _FRAME:
                    self._show(now)
                    continue
                if wait > 0.0:
                    until = self._drawn + _FRAME - now
                    self._answer(min(wait, until, _IDLE))
                else:
                    self._answer(0.0)
                    if not pacer.paused and not self._stopped:
                        live.step()
        except KeyboardInterrupt:  # a second one, which does not wait for a step
            pass
        except Exception as error:
            self.failure = error
        finally:
            gc.unfreeze()

    def save(self, out: Path, interrupts: Interrupts) -> RunResult:
        """Ends the page, and writes log, summary, plot and page as a run does.

        Args:
            out: the folder.
            interrupts: another Ctrl-C leaves it at what is there, the log at least.

        Raises:
            RunFailed: something stopped the simulation, or a file cannot be written.
            RunInterrupted: not all files were waited for.
        """
        interrupts.hold()  # until the log is written
        live = self.live
        self._server.show({"ended": f"ended after {live.time:.1f} s; see {out}"})
        scenario = with_lasting_name(live.logged_scenario())
        performer = live.setup.motion.performer
        return finish(
            *(live.recorder.log(scenario), scenario, live.setup),
            *(out, interrupts, self.failure),
            note=live.reported(),
            motion=inspect(performer) if performer is not None else None,
            warnings=[live.reported()],
        )

    def close(self) -> bool:
        """Ends the page and Meshcat, when all else is done.

        Returns:
            Whether the process can end as usual. An empty message from any web page
            ends the thread of Meshcat's web socket. Its destructor then waits for ever
            and is not called, and so the process would abort at its end.
        """
        self._server.close()
        meshcat, self._scene, self._meshcat = self._meshcat, None, None
        if meshcat is None or _is_alive(meshcat):
            return True
        pythonapi.Py_IncRef(py_object(meshcat))
        return False

    def say(self, text: str) -> None:
        """Tells a person who looks at the page something, for some seconds."""
        self._notice, self._notice_until = text, time.monotonic() + _NOTICE

    def _show(self, now: float) -> None:
        self._drawn = now
        if now > self._notice_until:
            self._notice = ""
        self._server.show(self._scene.frame(self.pacer, now, self._notice))

    def _answer(self, wait: float) -> None:
        """Does all that is asked for; waits so long at most [s] for the first of it."""
        try:
            request = self._server.requests.get(timeout=wait) if wait > 0.0 else None
            while True:
                if request is not None:
                    self._do(request)
                request = self._server.requests.get_nowait()
        except queue.Empty:
            return

    def _do(self, request: Request) -> None:
        live, pacer, now = self.live, self.pacer, time.monotonic()
        if request.do == "step":  # what this raises is no mistake of the page's
            if pacer.paused:
                live.step()
            return
        try:
            match request.do:
                case "pause" | "resume":
                    pacer.set_paused(request.do == "pause", now, live.time)
                case "stop":
                    self._stopped = True
                case "speed":
                    pacer.set_speed(request.value, now, live.time)
                case "offset":
                    live.set_offset(request.task, np.array(request.value))
                case "home":
                    live.take_offsets_away()
                case "ball":
                    live.set_ball(np.array(request.value))
                case "ball away":
                    live.set_ball(None)
                case "motion":
                    live.set_motion(request.value)
                case "push":
                    live.push(request.frame, np.array(request.value))
        except CrarError as error:  # wrong for this robot
            self.say(str(error))


def _is_alive(meshcat: Meshcat) -> bool:
    try:
        meshcat.port()
    except RuntimeError:
        return False
    return True


def _make_meshcat(host: str) -> Meshcat:
    """A Meshcat that listens where the page does."""
    params = MeshcatParams()
    params.host = host
    params.show_stats_plot = False
    try:
        return Meshcat(params)
    except RuntimeError as error:
        raise CrarError(f"Meshcat cannot listen at {host}: {error}") from error
