"""The original files of motors, servos and disks, alone or with what they turn; see `sources`."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import scipy.io

from benchmarks.measured.columns import Array, Columns, matlab, parts_of, timed

TACHO_RAD_S = 1000.0 / 3.0 * 2.0 * np.pi / 60.0
"""Speed for one volt of a tachometer that gives 3 V at 1000 turns a minute."""
LATHE_M = 0.010 / 8_388_608
"""Path of the lathe's cross slide for one count of its encoder: 10 mm a turn of the screw."""


def hsm150(folder: Path) -> dict[str, Columns]:
    """Columns of `data`: time, reference, angle, velocity, torque, measured torque, current."""
    parts = {}
    for name in ("pos_0.06_1", "neg_0.04_1", "pos_0.065_2", "neg_0.045_2"):
        data = np.asarray(matlab(folder / f"idf_{name}.mat", "data"), float)
        parts[name] = {"time_s": data[:, 0], "input_Nm": data[:, 4],
                       "position_rad": data[:, 2], "velocity_rad_s": data[:, 3]}
    return parts


def servo_motor(folder: Path) -> dict[str, Columns]:
    """Columns: angle, velocity (a difference of the angle), their references, torque command."""
    parts = {}
    for number in (1, 6):
        data = np.loadtxt(folder / f"data_S1_{number}.txt")
        parts[f"gains_{number}"] = timed(1e-3, input_Nm=data[:, 4], position_rad=data[:, 0],
                                         reference_rad=data[:, 2])
    return parts


def geared_motor(folder: Path) -> dict[str, Columns]:
    """Voltage and speed; the current is left out."""
    path = folder / "aprbsResult.mat"
    volts, speed = (np.asarray(matlab(path, name), float) for name in "uy")
    return {part: timed(0.02, input_v=volts[cut], velocity_rad_s=speed[cut])
            for part, cut in (("first", slice(0, 3361)), ("last", slice(3361, None)))}


def disc_motor(folder: Path) -> dict[str, Columns]:
    """Duty, wanted and measured counts (2000 a turn). The duty stands as volts."""
    data = scipy.io.loadmat(folder / "MotorIDinert.mat", squeeze_me=True, struct_as_record=False)
    entries = {e.Name: np.asarray(e.Data, float)
               for e in data["MotorData"].Data.MeasuredData}
    return {part: timed(5e-3, input_v=entries[f"data{key}/Duty"],
                        position_rad=np.pi / 1000.0 * entries[f"data{key}/Position"],
                        reference_rad=np.pi / 1000.0 * entries[f"data{key}/Ref"])
            for part, key in (("sine_0_3_hz", 3), ("sine_0_8_hz", 8), ("sine_0_1_hz", 1),
                              ("sine_0_5_hz", 5), ("sine_1_hz", 10))}


def course_motor(folder: Path) -> dict[str, Columns]:
    """Columns: time, voltage, speed (rad/s). Every fourth sample; sweeps and sine without the
    first second, of the stairs those to 6 and 9 V."""
    parts = {}
    for part, name, cut in (("sweep", "Chirp_Raw_1.mat", slice(2000, None, 4)),
                            ("sine", "Sine_Raw.mat", slice(2000, None, 4)),
                            ("sweep_again", "Chirp_Raw_4.mat", slice(2000, None, 4)),
                            ("stairs", "Stair_Raw.mat", slice(18_000, 56_000, 4))):
        data = scipy.io.loadmat(folder / name, squeeze_me=True, struct_as_record=False)["RawData"]
        parts[part] = timed(2e-3, input_v=np.asarray(data.Input, float)[cut],
                            velocity_rad_s=np.asarray(data.Velo, float)[cut])
    return parts


def furuta_base(folder: Path) -> dict[str, Columns]:
    """Angle of the base, PWM in steps of 10/255 V. The noise has no PWM stored: its voltage is
    the test signal."""
    tests = scipy.io.loadmat(folder / "baseTest.mat", squeeze_me=True)["baseTest"]
    signal = scipy.io.loadmat(folder / "testSignal.mat", squeeze_me=True)["testSignal"]
    voltage = signal["signal"].item()[:, 0]
    steps = 10.0 / 255.0 * tests[0]["PWM"]
    return {part: timed(5e-3, input_v=drive, position_rad=test["baseAngle"])
            for part, test, drive in (("noise_1", tests[1], voltage), ("steps", tests[0], steps))}


def _tacho(path: Path, parts: Mapping[str, slice]) -> dict[str, Columns]:
    """Voltage at the motor and voltage of its tachometer; the current is left out."""
    data = scipy.io.loadmat(path, squeeze_me=True)
    return {part: timed(0.01, input_v=data["motor"][cut],
                        velocity_rad_s=TACHO_RAD_S * data["tacho"][cut])
            for part, cut in parts.items()}


def tacho_motor(folder: Path) -> dict[str, Columns]:
    """Six of ten periods of 4 s, and the rest."""
    return _tacho(folder / "03-03-10 motor5.mat", {
        "first": slice(0, 2400), "rest": slice(2400, None)})


def geared_arm(folder: Path) -> dict[str, Columns]:
    """Five of eight periods of 10 s, and the rest."""
    return _tacho(folder / "09-04-10 nygear3.mat", {
        "first": slice(0, 5000), "rest": slice(5000, None)})


def _trace(path: Path) -> dict[str, Array]:
    """The variables of a controller's trace (XML), by the last word of their names."""
    found = re.finditer(r'<TraceVariable [^>]*VarName="([^"]*)".*?<Values>([^<]*)<',
                        path.read_text("utf-16"), re.DOTALL)
    return {variable[1].rpartition(":")[2]: np.fromstring(variable[2], sep=",")
            for variable in found}


def servo_drive(folder: Path) -> dict[str, Columns]:
    """Current (mA), speed and wanted speed (degrees/s). The axis turns evenly before and after
    what is taken. The stamps of the controller jitter by 1.3 %: even ones instead."""
    trace = _trace(folder / "JLoadWithoutFriction.trace")
    return {part: timed(1e-3, input_a=1e-3 * trace["Current"][cut],
                        velocity_rad_s=np.radians(trace["Velocity"][cut]),
                        reference_rad_s=np.radians(trace["RefVelocity"][cut]))
            for part, cut in (("first", slice(900, 3300)), ("rest", slice(3300, 5500)))}


def servo_pendulum(folder: Path) -> dict[str, Columns]:
    """Time, angle from hanging, wanted angle. The input is the duty (885 steps, its sign in 16
    bits) times the measured supply. The time stamps are those of the logger."""
    parts = {}
    for part, name in (("square_400", "10h29m37"), ("sines_400", "10h29m14"),
                       ("sines_200", "10h28m42"), ("square_800", "10h30m10")):
        text = (folder / f"2026-01-15_{name}.json").read_text("utf-8")
        time, load, supply, angle, wanted = (
            np.array([float(entry[key]) for entry in json.loads(text)["entries"]])
            for key in ("timestamp", "load", "input_volts", "position", "goal_position"))
        duty = np.where(load > 32_767, load - 65_536, load) / 885.0
        parts[part] = {"time_s": time - time[0], "input_v": np.clip(duty, -1.0, 1.0) * supply,
                       "position_rad": angle, "reference_rad": wanted}
    return parts


def torsion_disks(folder: Path) -> dict[str, Columns]:
    """Reference, input and angle of the third disk, six periods of 1023 samples."""
    path = folder / "FPdata.mat"
    reference, drive, angle = (np.asarray(matlab(path, name), float) for name in "ruy")
    return parts_of(timed(0.04, input_v=drive, position_rad=angle, reference_rad=reference),
                    {"first": slice(0, 4092), "rest": slice(4092, None)})


def screw_actuator(folder: Path) -> dict[str, Columns]:
    """Columns: time (ms), wanted position, position demand, position (mm), speed, current (mA)."""
    data = np.loadtxt(folder / "no-pp-sine-sweep-10mm-0.5Hz.txt")
    return parts_of({"time_s": 1e-3 * data[:, 0], "input_a": 1e-3 * data[:, 5],
                     "position_m": 1e-3 * data[:, 3], "reference_m": 1e-3 * data[:, 1]},
                    {"slow": slice(0, 1600), "faster": slice(1600, 2300)})


def serial_link(folder: Path) -> dict[str, Columns]:
    """Time, wanted and measured current of the first motor; time, wanted and measured angle
    (degrees) of the first joint. Every fourth sample."""
    parts = {}
    for part, name in (("partial", "psf"), ("full", "fsf")):
        current, angle = (np.asarray(matlab(folder / f"data_{name}_{what}.mat", f"data_{what}"),
                                     float)[::4] for what in ("Im1", "th11"))
        parts[part] = {"time_s": current[:, 0], "input_a": current[:, 2],
                       "position_rad": np.radians(angle[:, 2]),
                       "reference_rad": np.radians(angle[:, 1])}
    return parts


def _robot_runs(path: Path, position: str, column: int,
                runs: tuple[str, ...]) -> dict[str, Columns]:
    """Runs of WPILib's SysId: time, voltage (second column), position from where each begins. The
    sensors report every 20 ms, or the voltage does: every fourth sample of 5 ms."""
    content = json.loads(path.read_text("utf-8"))
    parts = {}
    for run in runs:
        data: Array = np.asarray(content[run], float)[::4]
        parts[run.replace("-", "_")] = {"time_s": data[:, 0] - data[0, 0],
                                        "input_v": data[:, 1],
                                        position: data[:, column] - data[0, column]}
    return parts


def ramp_motor(folder: Path) -> dict[str, Columns]:
    """Columns: time, voltage, angle (rad), speed, which the motor controller filters and which is
    left out. Ramps and steps in both directions."""
    return _robot_runs(folder / "sysid_data.json", "position_rad", 2,
                       ("slow-forward", "fast-backward", "slow-backward", "fast-forward"))


def robot_drive(folder: Path) -> dict[str, Columns]:
    """Columns: time, voltages, positions (m) and speeds of the left and of the right side, angle
    and its speed. The left side; its speed, which the motor controller filters, is left out."""
    return _robot_runs(folder / "sysid_data.json", "position_m", 3,
                       ("slow-forward", "fast-backward", "slow-backward", "fast-forward"))


def unbalanced_disk(folder: Path) -> dict[str, Columns]:
    """Voltage and angle (rad) from hanging: three stretches of a run of 35 000 samples."""
    data = np.load(folder / "training-val-test-data.npz")
    return parts_of(timed(0.025, input_v=data["u"], position_rad=data["th"]),
                    {"first": slice(0, 4000), "middle": slice(16_000, 20_000),
                     "large": slice(28_000, 32_000)})


def horizontal_arm(folder: Path) -> dict[str, Columns]:
    """Time, voltage and angle (rad) of steps to 0.4 rad. Every second sample."""
    parts = {}
    for part, gain in (("proportional", "00"), ("integral_12", "12"), ("integral_6", "06")):
        path = folder / f"picont_kP04_kI{gain}_data.mat"
        volts, angle = (np.asarray(matlab(path, name), float)[::2] for name in "uy")
        parts[part] = timed(2e-3, input_v=volts, position_rad=angle,
                            reference_rad=np.full(angle.size, 0.4))
    return parts


def driven_disk(folder: Path) -> dict[str, Columns]:
    """A table with decimal commas: time, angle of the disk, angle of the driver (rad), voltage and
    current of its motor, for each of 30 runs. Each run counts both angles from where it begins:
    their means are taken away. The driver's angle stands as voltage, for each interval the mean
    of both ends, as it moves on between the samples."""
    with (folder / "set_3_ddo(1).csv").open(encoding="utf-8-sig") as lines:
        head, *rows = csv.reader(lines, delimiter=";")
    place = {name: index for index, name in enumerate(head)}

    def column(name: str) -> Array:
        return np.array([float(row[place[name]].replace(",", ".")) for row in rows
                         if row[place[name]].strip()])

    parts = {}
    for part, run in (("three_volts", 5), ("four_volts", 9), ("two_volts", 3), ("six_volts", 13)):
        disk = column(f"Angle, Ch 1+2 (rad) Run #{run}")
        driver = column(f"Angle, Ch 3+4 (rad) Run #{run}")
        driver -= driver.mean()
        parts[part] = timed(0.05, input_v=(driver[:-1] + driver[1:]) / 2.0,
                            position_rad=(disk - disk.mean())[:-1])
    return parts


def hanging_load(folder: Path) -> dict[str, Columns]:
    """Columns: time, wanted position, position, input, all in volts. Every second sample; the
    first 40 s, in which the load sinks from another place, are left out."""
    data = np.loadtxt(folder / "HangingLoad.csv", delimiter=",")
    return {part: timed(0.04, input_v=data[cut, 3], position_m=data[cut, 2],
                        reference_m=data[cut, 1])
            for part, cut in (("top", slice(7000, 12_000, 2)), ("up", slice(2000, 7000, 2)),
                              ("down", slice(12_000, None, 2)))}


def aero_pitch(folder: Path) -> dict[str, Columns]:
    """Rows: time and voltage, time and pitch (rad). Every fifth sample, from before the pulse
    until the body has stood for a second."""
    volts, angle = (np.asarray(matlab(folder / f"{name}.mat", name), float)[1, 400:12_600:5]
                    for name in ("input", "pitch"))
    return {part: timed(0.01, input_v=volts[cut], position_rad=angle[cut])
            for part, cut in (("pulse", slice(0, 1644)), ("rest", slice(1644, None)))}


def _cross_slide(path: Path, cut: slice) -> Columns:
    """Columns: number, wanted X and Z, measured X and Z (counts), commands of speed of two
    controllers, torques of X and Z. From where the slide is wanted first."""
    data: Array = np.array(path.read_text("ascii").replace(",", " ").split(), float)
    data = data.reshape(-1, 11)
    start = data[0, 1]
    return timed(2e-3, input_v=data[cut, 9], position_m=LATHE_M * (data[cut, 3] - start),
                 reference_m=LATHE_M * (data[cut, 1] - start))


def lathe_axis(folder: Path) -> dict[str, Columns]:
    """Large and small circles of one file, and a spiral. Every second sample."""
    return {part: _cross_slide(folder / f"NCTU_G02_{name}.TXT", slice(first, last, 2))
            for part, name, first, last in (("large_circles", "circle", 0, 10_000),
                                            ("small_circles", "circle", 10_000, 19_340),
                                            ("spiral", "spiral", 0, 10_000))}


def digger_boom(folder: Path) -> dict[str, Columns]:
    """Columns: time, four measured values, four duties (percent), four errors. The stamps are
    7 ms apart with jitter: even ones of 20 ms instead. The duty counts from its middle and
    stands as volts."""
    data = np.loadtxt(folder / "autonomous_1024_1959.csv", delimiter=",", skiprows=1,
                      usecols=(0, 1, 5))
    time = np.arange(data[0, 0], data[-1, 0], 0.02)
    place, duty = (np.interp(time, data[:, 0], data[:, column]) for column in (1, 2))
    return {part: timed(0.02, input_v=duty[cut] - 7.4745, position_m=0.01 * place[cut])
            for part, cut in (("first", slice(0, 3200)), ("last", slice(3200, None)))}


def piezo_flexure(folder: Path) -> dict[str, Columns]:
    """First column: voltage, fifth: capacitive sensor (um)."""
    parts = {}
    for part, name, cut in (("shrinking", "Test_Vi_Do_Di.dat", slice(2200, 4200)),
                            ("growing", "Test_Vi_Do_Di.dat", slice(4800, 6800)),
                            ("bent", "Test_Vi_Do_Di.dat", slice(8600, 10_600)),
                            ("wide", "Model_Vi_Do.dat", slice(1600, 3200))):
        volts, micrometres = np.loadtxt(folder / name, usecols=(0, 4), unpack=True)
        parts[part] = timed(5e-3, input_v=volts[cut], position_m=1e-6 * micrometres[cut])
    return parts


def _stamped(path: Path, stamp: int, value: int) -> tuple[list[int], Array]:
    """Stamps (ns, whole numbers) and one column of a table."""
    rows = [line.split(",") for line in path.read_text("ascii").splitlines()[1:]]
    return [int(row[stamp]) for row in rows], np.array([float(row[value]) for row in rows])


def model_car(folder: Path) -> dict[str, Columns]:
    """Throttle by its own stamps, speed by those of the car; both set on even ones of 20 ms, so
    that samples which the radio lost are interpolated. Until the car stands for good."""
    sent, throttle = _stamped(folder / "vehicleCommand.csv", 0, 4)
    stamps, speed = _stamped(folder / "vehicleState.csv", 2, 9)
    time = 2.0 + 0.02 * np.arange(3965)
    throttle, speed = (np.interp(time, 1e-9 * np.array([stamp - stamps[0] for stamp in own]), held)
                       for own, held in ((sent, throttle), (stamps, speed)))
    return {part: timed(0.02, input_v=throttle[cut], velocity_m_s=speed[cut])
            for part, cut in (("reverses", slice(1900, None)), ("forwards", slice(0, 1900)))}


def _wheel(path: Path, cut: slice) -> Columns:
    """Lines of names and values: time (us), PWM, speeds of three wheels (inches/s)."""
    rows = [line.split(",") for line in path.read_text("ascii").splitlines()]
    data: Array = np.array([[float(row[3]), float(row[9])] for row in rows
                            if len(row) == 10 and row[0] == "t"])[cut]
    return timed(2 * 0.0100925, input_v=12.0 / 255.0 * data[:, 0],
                 velocity_m_s=0.0254 * data[:, 1])


def omni_wheel(folder: Path) -> dict[str, Columns]:
    """Every second sample, after a gap in the first lines."""
    return {part: _wheel(folder / f"{name}.csv", slice(first, last, 2))
            for part, name, first, last in (("stairs", "steps", 311, 10_311),
                                            ("larger", "steps", 10_311, 15_311),
                                            ("forward", "forward", 10, 5375))}


MOTORS = (hsm150, servo_motor, geared_motor, disc_motor, course_motor, furuta_base, tacho_motor,
          geared_arm, servo_drive, servo_pendulum, torsion_disks, screw_actuator, serial_link,
          ramp_motor, robot_drive, unbalanced_disk, horizontal_arm, driven_disk,
          hanging_load, aero_pitch, lathe_axis, digger_boom, piezo_flexure, model_car, omni_wheel)
