"""The original files of free swings: pendulums, a sprung cart, a wheel; see `sources`."""

from __future__ import annotations

import csv
import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import scipy.io

from benchmarks.measured.columns import Array, Columns, matlab, parts_of, timed


def _cut(time: Array, angle: Array, parts: Mapping[str, slice]) -> dict[str, Columns]:
    """Parts of a swing (rad) that nothing drives."""
    return {part: {"time_s": time[cut], "input_Nm": np.zeros(time[cut].size),
                   "position_rad": angle[cut]} for part, cut in parts.items()}


def dry_pendulum(folder: Path) -> dict[str, Columns]:
    """Columns: time, angle from upright, velocity. From a turning point at 2.4 rad on, near where
    the source starts, as the angle from hanging."""
    data = np.loadtxt(folder / "test1pend1.csv", delimiter=",")[779:]
    return _cut(data[:, 0], data[:, 1] - np.pi, {
        "first": slice(0, 6700), "rest": slice(6700, None)})


def rod_pendulum(folder: Path) -> dict[str, Columns]:
    """Columns: time, angle (degrees), in thirds of 30 s."""
    data = np.loadtxt(folder / "galileo_2024-07-19_15-25-54.csv", delimiter=",", skiprows=1)
    return _cut(data[:, 0], np.radians(data[:, 1]), {
        "large": slice(0, 1500), "small": slice(3000, 4500), "middle": slice(1500, 3000)})


def stepper_pendulum(folder: Path) -> dict[str, Columns]:
    """Angle (degrees), from just after the first turning point on. Every fifth sample."""
    parts = {}
    for number, first in ((1, 252), (2, 150), (3, 144)):
        path = folder / f"pendulum_free_swing_data_{number:02d}.txt"
        angle = np.loadtxt(path, skiprows=2)[first::5]
        parts[f"run_{number}"] = timed(5e-3, input_Nm=np.zeros(angle.size),
                                       position_rad=np.radians(angle))
    return parts


def hand_pendulum(folder: Path) -> dict[str, Columns]:
    """Time and angle (rad), from just after the release on. Every tenth sample."""
    time, angle = (np.asarray(matlab(folder / "cdip_pend_data.mat", name), float)[4200::10]
                   for name in ("t", "theta"))
    return _cut(time, angle, {"large": slice(0, 4580), "small": slice(4580, None)})


def arm_pendulum(folder: Path) -> dict[str, Columns]:
    """Time and angle (rad), from after the release on. Every tenth sample."""
    time, angle = (np.asarray(matlab(folder / "adip_pend_data.mat", name), float)[2700::10]
                   for name in ("t", "theta2"))
    return _cut(time, angle, {"large": slice(0, 5862), "small": slice(5862, None)})


def second_pendulum(folder: Path) -> dict[str, Columns]:
    """Columns: time, angle from upright, velocity. From a turning point at 2.7 rad on, as the
    angle from hanging."""
    data = np.loadtxt(folder / "test1pend2.csv", delimiter=",")[198:]
    return _cut(data[:, 0], data[:, 1] - np.pi, {
        "first": slice(0, 4360), "rest": slice(4360, None)})


def _rod_swing(path: Path, first: int, last: int | None = None) -> Columns:
    """A free swing of a rod. Columns: angle of the rod, its speed twice, position of the
    cart (cm), its speed twice, voltage, time (ms). As the angle from where the rod stands at the
    end of the file."""
    data = np.loadtxt(path, delimiter=",")
    angle = data[:, 0] - np.median(data[-100:, 0])
    return timed(0.01, input_Nm=np.zeros(angle[first:last].size), position_rad=angle[first:last])


def long_rod(folder: Path) -> dict[str, Columns]:
    """From the first turning point on, and a swing that a move of the cart has left, from after
    the cart stands."""
    return {"first": _rod_swing(folder / "swobodna.txt", 3520, 7720),
            "rest": _rod_swing(folder / "swobodna.txt", 7720),
            "after_a_move": _rod_swing(folder / "6v.txt", 380)}


def short_rod(folder: Path) -> dict[str, Columns]:
    """From the first turning point on, and swings that moves of the cart have left, from after
    the cart stands."""
    return {"large": _rod_swing(folder / "swobodna.txt", 820),
            "after_12_v": _rod_swing(folder / "12v.txt", 530),
            "after_10_v": _rod_swing(folder / "10v.txt", 435)}


def sprung_pendulum(folder: Path) -> dict[str, Columns]:
    """Time and angle (degrees) in an object that only its maker's program opens; its arrays stand
    in the file as they are. From 4 s on, every tenth sample."""
    path = folder / "pendulum_oscillation.mat"
    raw = scipy.io.loadmat(path)["__function_workspace__"].tobytes()
    size = 39_650
    tag = struct.pack("<II", 9, 8 * size)
    start = raw.index(tag) + len(tag)
    time = np.frombuffer(raw, "<f8", size, start)
    angle = np.frombuffer(raw, "<f8", size, raw.index(tag, start + 8 * size) + len(tag))
    return _cut(time[4001::10], np.radians(angle[4001::10]), {
        "first": slice(0, 2500), "rest": slice(2500, None)})


def freed_cart(folder: Path) -> dict[str, Columns]:
    """One column: position (cm). From the first turning point on, from where the cart stands at
    the end of the file."""
    parts = {}
    for part, name, first in (("run_1", "Klow_Hand_2mass", 410),
                              ("run_2", "Klow_hand_2mass2", 324),
                              ("run_3", "Klow_hand_2mass3", 215)):
        position = 0.01 * np.loadtxt(folder / f"{name}_data0000.txt")
        position = position[first:] - np.median(position[-20:])
        parts[part] = timed(5e-3, input_N=np.zeros(position.size), position_m=position)
    return parts


def leaf_pendulum(folder: Path) -> dict[str, Columns]:
    """Columns: time of day, time, angle (degrees). From the second turning point on, from where
    the pendulum stands at the end of the file. The lines arrive in bunches, 259.54 a second over
    the whole file: even time stamps instead of theirs."""
    degrees = np.loadtxt(folder / "100.txt", delimiter=",", skiprows=2, usecols=2)
    angle = np.radians(degrees - np.median(degrees[-100:]))
    return _cut(np.arange(angle.size) / 259.54, angle, {
        "large": slice(245, 4245), "small": slice(4245, 9000)})


def coupled_pendulums(folder: Path) -> dict[str, Columns]:
    """Columns: time, angles of both pendulums (degrees). The second one, about the middle of the
    run, on even time stamps: those of the logger jitter by up to 8 ms about their mean."""
    data = np.loadtxt(folder / "3.3.txt", skiprows=2)
    time = 0.025 * np.arange(int(data[-1, 0] / 0.025)) + 0.025
    angle = np.radians(np.interp(time, data[:, 0], data[:, 2] - data[:, 2].mean()))
    return _cut(time - time[0], angle, {"first": slice(0, 1500), "rest": slice(1500, None)})


def encoder_pendulum(folder: Path) -> dict[str, Columns]:
    """Columns: time, angle (rad) from hanging. Every second sample."""
    parts: dict[str, Columns] = {}
    for number in (31, 33):
        data = np.loadtxt(folder / f"data{number}.csv", delimiter=",", skiprows=1)[::2]
        parts |= _cut(data[:, 0] - data[0, 0], data[:, 1], {f"run_{number}": slice(None)})
    return parts


def bicycle_wheel(folder: Path) -> dict[str, Columns]:
    """Columns: time, speed (rad/s) of a rate gyroscope on the wheel."""
    path = folder / "bicycle-wheel-radial-inertia-rate-gyro-measurement.csv"
    data = np.loadtxt(path, delimiter=",", skiprows=1)
    return parts_of({"time_s": data[:, 0], "input_Nm": np.zeros(len(data)),
                     "velocity_rad_s": data[:, 1]},
                    {"first": slice(0, 600), "rest": slice(600, None)})


def gimbal_pendulum(folder: Path) -> dict[str, Columns]:
    """Stamp of the message (s) and angle (rad) from hanging. Every fourth sample from the first
    turning point on, up to where 20 samples are missing; and from 0.4 s after that, when the
    logger has caught up, until it nearly stands."""
    path = folder / "hardware_pure_joint1_oscillations.csv"
    with path.open(encoding="utf-8") as lines:
        rows = [(float(row["/joint_states/header/stamp"]),
                 float(row["/joint_states/joint1/position"])) for row in csv.DictReader(lines)]
    time, angle = np.array(rows).T
    gap = int(np.argmax(np.diff(time))) + 1
    start = int(np.argmin(angle))
    return _cut(time - time[start], angle, {"large": slice(start, gap, 4),
                                            "small": slice(gap + 200, gap + 5400, 4)})


def remote_pendulum(folder: Path) -> dict[str, Columns]:
    """Columns: time, angle, speed. The file holds three logs, each of which starts anew: the
    last one, from a turning point after the drive is off until the pendulum nearly stands."""
    time, angle = np.loadtxt(folder / "pend00-run06.csv", delimiter=",", skiprows=1,
                             usecols=(0, 1), unpack=True)
    first = int(np.flatnonzero(np.diff(time) < 0.0)[-1]) + 60
    parts = {}
    for part, cut in (("large", slice(first, first + 555)),
                      ("small", slice(first + 555, first + 905))):
        swing = angle[cut]
        parts[part] = timed(0.02, input_v=np.zeros(swing.size), position_rad=swing)
    return parts


FREE_SWINGS = (dry_pendulum, rod_pendulum, stepper_pendulum, hand_pendulum, arm_pendulum,
               second_pendulum, long_rod, short_rod, sprung_pendulum, freed_cart, leaf_pendulum,
               coupled_pendulums, encoder_pendulum, bicycle_wheel, gimbal_pendulum,
               remote_pendulum)
