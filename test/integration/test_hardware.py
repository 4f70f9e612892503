"""The graph on emulated hardware: real drivers and serial stack, every device its own process."""

from __future__ import annotations

import signal
import subprocess
import sys

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray

from benchmarks.zero_current import ZeroCurrentRig, moving_stage
from dfm_interfaces.msg import Drive, Measurement
from dfm_stage.harness import HarnessError
from dfm_stage.harness.emulated import EmulatedDevice, EmulatedGraph
from dfm_stage.harness.emulator_link import StageLink
from dfm_stage.nodes.process import Helper
from dfm_stage.nodes.wiring import PUBLISHER_QOS
from dfm_stage.recording import read_bag

pytestmark = pytest.mark.real_time

# a busy machine holds up even an emulator; here it is not time that is tested
PATIENT = {"encoder_driver": {"encoder_timeout_s": 1.0},
           "amplifier_driver": {"stale_timeout_s": 0.5, "measurement_timeout_s": 0.5}}
SCAN = {"name": "scan", "mode": "pid", "duration_s": 4.0, "axes": {"x": {"reference": {
    "kind": "raster", "line_length_m": 0.002, "line_time_s": 0.8, "turnaround_s": 0.2}}}}
ATTEMPTS = 4


@pytest.mark.slow
def test_a_whole_scan_through_both_emulators(tmp_path):
    for attempt in range(ATTEMPTS):
        bag = tmp_path / f"bag{attempt}"
        with EmulatedGraph(bag=bag, parameters=PATIENT) as graph:
            graph.bring_to_life()
            try:
                result = graph.run(SCAN)["x"]
                cut = graph.cut()
            except HarnessError as error:  # a machine that stood still for half a second
                cut = str(error)
            graph.stop_recording()
        if not cut:
            break
    assert not cut, f"{ATTEMPTS} scans were cut short, the last one: {cut}"
    topics = read_bag(bag)
    measurement, reference, amplifier, plant = (
        topics[f"/stage/x/{name}"] for name in ("measurement", "reference", "amplifier", "plant"))
    first, last = result.first_seq + 1024, result.last_seq
    assert last - result.first_seq + 1 == 4 * 512
    wanted = dict(zip(reference["seq"].tolist(), reference["position"].tolist(), strict=True))
    inside = [(position - wanted[seq], flags) for seq, position, flags in zip(
        measurement["seq"].tolist(), measurement["position"].tolist(),
        measurement["flags"].tolist(), strict=True) if first <= seq <= last and seq in wanted]
    assert len(inside) > 900
    errors = np.array([error for error, _ in inside])
    assert np.median(np.abs(errors)) < 2e-4, "it follows a raster of 2 mm"
    assert all(flags & 1 for _, flags in inside), "referenced"
    # what the drivers measured is where the simulated stage really was
    middle = (measurement["seq"] >= first) & (measurement["seq"] <= last)
    truth = np.interp(measurement["header.stamp"][middle].astype(float),
                      plant["header.stamp"].astype(float), plant["position"])
    offset = np.median(measurement["position"][middle] - truth)
    assert np.median(np.abs(measurement["position"][middle] - truth - offset)) < 2e-5
    assert np.ptp(truth) > 1.5e-3
    applied = amplifier["voltage"][amplifier["enabled"]]
    assert np.allclose(applied / 0.01, np.round(applied / 0.01), atol=1e-6), "steps of 10 mA"


def outputs(graph):
    lines = graph.output_log.read_text().splitlines()
    return [(float(line.split()[1]), line.split()[2]) for line in lines]


def test_nothing_is_energised_before_configure_activate_and_arm_in_that_order():
    with EmulatedGraph(parameters=PATIENT) as graph:
        assert not graph.transition("amplifier_driver", "activate")
        assert not graph.trigger("amplifier_driver", "arm")[0]
        assert not graph.trigger("encoder_driver", "home")[0]
        for kind in ("encoder_driver", "amplifier_driver"):
            assert graph.transition(kind, "configure")
        assert "activate it first" in graph.trigger("amplifier_driver", "arm")[1]
        for kind in ("encoder_driver", "amplifier_driver"):
            assert graph.transition(kind, "activate")
        graph.spin(0.5)
        done, message = graph.trigger("amplifier_driver", "arm")
        assert not done
        assert "not referenced" in message
        assert outputs(graph) == []
        graph._insist("encoder_driver", "home")
        graph._insist("amplifier_driver", "arm")
        assert outputs(graph)[0] == (0.0, "on")
        heard = []
        graph._client_node.create_subscription(DiagnosticArray, "/diagnostics", heard.append, 50)
        graph.spin_until(lambda: {"drive temperature", "bus voltage", "latched faults"}
                         <= told(heard, "amplifier_driver").keys(), 30.0,
                         "what the drive says in diagnostics")
        values = told(heard, "amplifier_driver")
        assert values["device"].startswith("Copley drive")
        assert {"output rate", "age of last command", "malformed_lines", "retries", "current",
                "current limit", "latched faults", "bus voltage", "encoder"} <= values.keys()
        graph.spin_until(lambda: {"device", "sample rate", "age of last sample", "malformed_lines",
                                  "resets_seen", "travel limit", "referenced"}
                         <= told(heard, "encoder_driver").keys(), 30.0,
                         "what the encoder says in diagnostics")
        assert told(heard, "encoder_driver")["device"] == "QSB-D serial 00E5A firmware 2A"
        assert graph.transition("amplifier_driver", "deactivate")
        assert outputs(graph)[-1] == (0.0, "off")
        assert graph.transition("amplifier_driver", "cleanup")


def told(heard, kind):
    for array in reversed(heard):
        for status in array.status:
            if status.name == f"/stage/x/{kind}":
                return {value.key: value.value for value in status.values}
    return {}


@pytest.mark.slow
def test_every_way_to_fail_is_zero_and_stays_zero_and_the_driver_ends_with_it_off():
    with moving_stage() as rig:
        rig.open_publisher()
        for kind in ("nan_command", "stalled_controller", "pulled_encoder", "killed_controller"):
            assert struck(rig, kind) >= 0.0
        rig._wait_for_current()
        driver = next(each for each in rig.graph.launched if each.kind == "amplifier_driver")
        rig.graph.launched.remove(driver)
        driver.process.send_signal(signal.SIGTERM)
        assert driver.process.wait(20.0) == 0
        rig.output.read()
        assert rig.output.off
        assert rig.output.current_a == 0.0


def struck(rig: ZeroCurrentRig, kind: str) -> float:
    """Strike until the cause is the one that was struck: the machine may have been first."""
    for _ in range(ATTEMPTS):
        taken = rig.measure(kind)
        if taken == taken:
            return taken
    raise AssertionError(rig.others)


@pytest.mark.slow
def test_a_drive_that_was_gone_comes_back_off_and_a_counter_unreferenced():
    with moving_stage() as rig:
        graph = rig.graph
        numbers = []
        graph._client_node.create_subscription(Measurement, "/stage/x/measurement",
                                               lambda message: numbers.append(message.seq), 1000)
        rig._wait_for_current()
        struck_ns = graph.devices["amplifier"].inject("disconnect 0.5")
        graph.devices["encoder"].inject("disconnect 0.5")
        graph.spin_until(lambda: rig.output.zero_since(struck_ns) is not None, 30.0,
                         "zero at the first word after the break")
        before = len(rig.output.changes)
        graph.spin(1.0)
        rig.output.read()
        assert len(rig.output.changes) == before, "nothing was resumed"
        done, message = graph.trigger("amplifier_driver", "arm")
        assert not done
        assert "not referenced" in message or "clear first" in message
        rig._wait_for_current()
        assert numbers == sorted(set(numbers)), "measurements are numbered on"


@pytest.mark.parametrize(("arguments", "words"), [
    (["copley_ascii", "--flash", "nonsense"], "--flash nonsense"),
    (["qsb_d", "--link", "/nowhere/port"], "cannot put a port at /nowhere/port")])
def test_emulate_refuses_in_one_line(arguments, words):
    done = subprocess.run([sys.executable, "-m", "dfm_stage", "emulate", *arguments],
                          stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=60.0,
                          check=False)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert words in done.stderr


def test_emulate_takes_faults_by_line(tmp_path):
    device = EmulatedDevice("copley_ascii", tmp_path / "port", "--log", str(tmp_path / "log"))
    try:
        assert device.inject("fault 0x4") > 0
        assert device.inject("enable off") > 0
        assert (tmp_path / "port").is_symlink()
    finally:
        device.close()
    assert not (tmp_path / "port").exists()
    with pytest.raises(HarnessError, match="did not start"):
        EmulatedDevice("copley_ascii", tmp_path / "no" / "port")


def test_an_emulated_device_has_met_the_plant_before_it_offers_its_port():
    link = StageLink("/stage/x", "copley_ascii_emulator", 1e-3)
    plant = None
    try:
        link.drive_coil()
        assert not link.met(0.05), "nobody is there yet"
        plant = Helper("sim_plant", "/stage/x")
        plant.node.create_subscription(Drive, "sim/drive", lambda _: None, PUBLISHER_QOS)
        assert link.met(20.0)
    finally:
        for each in filter(None, (link._ros, plant)):
            each.close()
