"""The whole graph on emulated hardware: real drivers, real serial stack, simulated stage.

>>> with EmulatedGraph(bag="bags/emulated") as graph:
...     graph.bring_to_life()
...     graph.run({...})

Two processes stand where the counter and the amplifier stand (emulator_process), connected to
sim_plant on one side and to pseudo-terminals on the other.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from std_srvs.srv import Trigger

from dfm_stage.drivers.qsb_protocol import TICKS_PER_SECOND
from dfm_stage.harness.node_set import HarnessError
from dfm_stage.harness.stage_graph import StageGraph
from dfm_stage.model import load_model

RESOLUTION_M = 5e-8
SERVICE_S = 15.0
DRIVERS = ("encoder_driver", "amplifier_driver")


class EmulatedDevice:
    """One emulator in a process of its own.

    Parameters
    ----------
    device : str
        `qsb_d` or `copley_ascii`.
    link : path
        Where its port is to be found.
    arguments : str
        Further arguments of `./run emulate`.
    domain_id : int, optional
        The ROS domain of the stage it is connected to.
    """

    def __init__(self, device: str, link: Path, *arguments: str,
                 domain_id: int | None = None) -> None:
        environment = dict(os.environ)
        if domain_id is not None:
            environment["ROS_DOMAIN_ID"] = str(domain_id)
        self.link = link
        self._process = subprocess.Popen(
            [sys.executable, "-m", "dfm_stage.harness.emulator_process", device, "--link",
             str(link), *arguments],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1, env=environment)
        if not self._answer():
            self.close()
            raise HarnessError(f"emulate {device} did not start: see its words above")

    def _answer(self) -> str:
        assert self._process.stdout is not None  # noqa: S101
        return self._process.stdout.readline().strip()

    def inject(self, fault: str) -> int:
        """Type one line; return the steady clock in ns when it was done."""
        assert self._process.stdin is not None  # noqa: S101
        self._process.stdin.write(f"{fault}\n")
        self._process.stdin.flush()
        answer = self._answer()
        if not answer:
            raise HarnessError(f"the emulator did not take {fault!r}")
        return int(answer.split()[0])

    def close(self) -> None:
        """End it."""
        with self._process:  # closes the pipes and waits
            self._process.terminate()
            try:
                self._process.wait(5.0)
            except subprocess.TimeoutExpired:
                self._process.kill()


def hardware_parameters(encoder: Path, amplifier: Path) -> dict[str, dict[str, Any]]:
    """Return the node parameters of a loop on both devices."""
    return {
        # an emulator is a process, which a busy machine may hold up for longer than 20 ms
        "encoder_driver": {"device": "qsb_d", "port": str(encoder), "retry_s": 0.2,
                           "resolution_m": RESOLUTION_M, "encoder_timeout_s": 0.1},
        "amplifier_driver": {"device": "copley_ascii", "port": str(amplifier),
                             "current_limit_a": 2.0, "retry_s": 0.2, "reply_timeout_s": 0.3},
        # soft enough for the delay of the wires and of a busy machine; the feedforward is what
        # the spring, the damper and the mass of current_stage take, per N/A
        "controller": {"kp": 600.0, "ki": 6000.0, "kd": 30.0,
                       "output_limit_v": 2.0, "derivative_weight": 1.0,
                       "feedforward_position": 600.7, "feedforward_velocity": 1.705,
                       "feedforward_acceleration": 1.0},
    }


class EmulatedGraph(StageGraph):
    """A StageGraph of one axis whose drivers talk to emulators on pseudo-terminals.

    After entering it the drivers are unconfigured, as with real devices.
    """

    def __init__(self, *, model: str = "current_stage",
                 parameters: Mapping[str, Mapping[str, Any]] | None = None,
                 amplifier_arguments: tuple[str, ...] = (),
                 encoder_arguments: tuple[str, ...] = (), **options: Any) -> None:
        self._ports = tempfile.TemporaryDirectory(prefix="dfm_ports_")
        folder = Path(self._ports.name)
        self._links = {"encoder": folder / "encoder", "amplifier": folder / "amplifier"}
        self._arguments = {"encoder": encoder_arguments, "amplifier": amplifier_arguments}
        self.output_log = folder / "output.log"
        merged = hardware_parameters(self._links["encoder"], self._links["amplifier"])
        if (kinds := options.get("nodes")) is not None:
            merged = {kind: values for kind, values in merged.items() if kind in kinds}
        for kind, values in (parameters or {}).items():
            merged[kind] = {**merged.get(kind, {}), **values}
        self.devices: dict[str, EmulatedDevice] = {}
        self._plant_period_s = load_model(model).sample_period
        super().__init__(model=model, parameters=merged,
                         sample_period_s=1.0 / TICKS_PER_SECOND, **options)

    def __enter__(self) -> EmulatedGraph:
        super().__enter__()
        try:
            stage = ("--stage", f"/stage/{self.axes[0]}",
                     "--sample-period", str(self._plant_period_s))
            for name, device, extra in (
                    ("encoder", "qsb_d", ("--resolution", str(RESOLUTION_M))),
                    ("amplifier", "copley_ascii", ("--log", str(self.output_log)))):
                self.devices[name] = EmulatedDevice(
                    device, self._links[name], *stage, *extra, *self._arguments[name],
                    domain_id=self._domain_id)
        except BaseException:
            self.close()
            raise
        return self

    def node(self, kind: str) -> str:
        """Return the full name of a driver node."""
        return f"/stage/{self.axes[0]}/{kind}"

    def transition(self, kind: str, name: str) -> bool:
        """Ask for a transition (`configure`, `activate`, ...); return whether it succeeded."""
        request = ChangeState.Request(
            transition=Transition(id=getattr(Transition, f"TRANSITION_{name.upper()}")))
        # asked once only: a transition that was made is refused the second time
        return bool(self.call(ChangeState, f"{self.node(kind)}/change_state", request, SERVICE_S,
                              again_s=SERVICE_S).success)

    def trigger(self, kind: str, service: str) -> tuple[bool, str]:
        """Call `arm`, `disarm`, `clear` or `home`; return success and message."""
        answer = self.call(Trigger, f"{self.node(kind)}/{service}", Trigger.Request())
        return bool(answer.success), str(answer.message)

    def bring_to_life(self) -> None:
        """Configure and activate both drivers, take the rest position as zero, arm.

        Raises
        ------
        HarnessError
            With what was refused and why.
        """
        for kind in DRIVERS:
            for name in ("configure", "activate"):
                if not self.transition(kind, name):
                    raise HarnessError(f"{kind} refused to {name}: see its log and diagnostics")
        self._insist("encoder_driver", "home")
        self._insist("amplifier_driver", "arm")

    def cut(self) -> str:
        """Return why the output was cut, if it was; asks the driver to arm an armed output."""
        done, message = self.trigger("amplifier_driver", "arm")
        return "" if done else message

    def _insist(self, kind: str, service: str) -> None:
        deadline = time.monotonic() + SERVICE_S
        while not (answer := self.trigger(kind, service))[0]:
            if time.monotonic() > deadline:
                raise HarnessError(f"{kind} refused to {service}: {answer[1]}")
            self.spin(0.05)

    def close(self) -> None:
        """End the graph, then the devices: the drivers still zero the output."""
        super().close()
        for device in self.devices.values():
            device.close()
        self.devices.clear()
        self._ports.cleanup()
