"""The original files of the records, read as the columns that `diagnose` understands.

A reader takes the folder with the reader's own copy of the files and returns the parts that
records.yaml names, each as columns `time_s`, `input_<unit>`, `position_<unit>` or
`velocity_<unit>_s` (or an acceleration), with `reference_<unit>` in closed loop. It cuts, takes
every n-th sample and changes units; it never filters.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import scipy.io

from benchmarks.measured.columns import Array, Columns, Reader, matlab, parts_of, timed
from benchmarks.measured.free_swings import FREE_SWINGS
from benchmarks.measured.motors import MOTORS

STANDARD_GRAVITY = 9.80665


def _shared(path: Path) -> Columns:
    """An .npz whose columns have our names already."""
    with np.load(path) as data:
        return {name: np.asarray(data[name], float) for name in data.files}


def silverbox(folder: Path) -> dict[str, Columns]:
    """The split that the benchmark prescribes."""
    return {"train": _shared(folder / "train.npz"),
            "multisine": _shared(folder / "holdout_multisine.npz"),
            "arrow": _shared(folder / "holdout_arrow_full.npz")}


def emps(folder: Path) -> dict[str, Columns]:
    """The split that the benchmark prescribes."""
    return {name: _shared(folder / f"{name}.npz") for name in ("train", "holdout")}


def motor_bench(folder: Path) -> dict[str, Columns]:
    """Measured current to motor angle, without the first, transient period."""
    parts = {}
    for part in "ab":
        with np.load(folder / f"motor_bench_multisine{part.upper()}.npz") as data:
            first = int(data["period"])
            parts[part] = timed(1.0 / float(data["fs"]), input_a=data["iq"][first:],
                                 position_rad=data["theta_motor"][first:])
    return parts


def beam(folder: Path) -> dict[str, Columns]:
    """Eight seconds of the decay, from where the drive has stopped."""
    with np.load(folder / "decay.npz") as data:
        strain = data["strain"][12_600:20_600, 0]
    return {"decay": {**timed(1e-3, input_v=np.zeros(strain.size)), "strain": strain}}


def quarter_drone(folder: Path) -> dict[str, Columns]:
    """The time stamps are those of the logger; percent of full drive stands as volts."""
    with (folder / "dados_14_drone.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    time, angle, drive, wanted = (np.array([float(row[name]) for row in rows]) for name in (
        "tempo_ms", "angulo_deg", "u_pct", "referencia"))
    columns = {"time_s": 1e-3 * time, "input_v": drive, "position_rad": np.radians(angle),
               "reference_rad": np.radians(wanted)}
    return parts_of(columns, {"first": slice(0, 6000), "second": slice(6000, 12_000)})


def pendulum(folder: Path) -> dict[str, Columns]:
    """The angle from hanging; the parts of the source follow each other without a gap."""
    path = folder / "SinglePendulumDataForParameterEstimation.mat"
    parts = {}
    for part, name in (("identification", "Y_id"), ("validation", "Y_vad")):
        angle = np.concatenate([each[0] for each in matlab(path, name)])[::4] - np.pi
        parts[part] = timed(4e-3, input_Nm=np.zeros(angle.size), position_rad=angle)
    return parts


def aero_pendulum(folder: Path) -> dict[str, Columns]:
    """Columns: angle, fan voltage."""
    parts = {}
    for name in ("ident", "val"):
        data = np.loadtxt(folder / f"{name}_data.txt", delimiter=",", skiprows=1)
        parts[name] = timed(0.01, input_v=data[:, 1], position_rad=data[:, 0])
    return parts


def harvester(folder: Path) -> dict[str, Columns]:
    """Time and value of base acceleration (g), piezo voltage, velocity; the force on 1 kg."""
    parts = {}
    for level in (100, 150, 200):
        data = np.loadtxt(folder / f"amplitude_{level}mV.csv", delimiter=",")
        parts[f"{level}mV"] = timed(1.0 / 64.0, input_N=-STANDARD_GRAVITY * data[:, 1],
                                     velocity_m_s=data[:, 5])
    return parts


def double_beam(folder: Path) -> dict[str, Columns]:
    """Decays number 1, 5, 9 (fitted) and 2, 6 (the source's test set), from 20 ms on."""
    decays = matlab(folder / "data.mat", "xData")
    parts = {}
    for number in (1, 5, 9, 2, 6):
        velocity = np.asarray(decays[number - 1][1], float)[102:]
        parts[f"blow_{number}"] = timed(1.0 / 5120.0, input_N=np.zeros(velocity.size),
                                         velocity_m_s=velocity)
    return parts


def robot_arm(folder: Path) -> dict[str, Columns]:
    """Columns: reaction torque, acceleration; halves as others split it."""
    data = np.loadtxt(folder / "robot_arm.dat")
    return {part: timed(0.01, input_N=data[cut, 0], acceleration_m_s2=data[cut, 1])
            for part, cut in (("first_half", slice(0, 512)), ("second_half", slice(512, 1024)))}


def servo_link(folder: Path) -> dict[str, Columns]:
    """Samples 2127 to 3911 as the source selects them; the command stands meanwhile."""
    path = folder / "resultID.mat"
    drive, tip = (np.asarray(matlab(path, name), float)[2126:3911] for name in "uy")
    return {part: timed(3e-3, input_v=drive[cut], acceleration_m_s2=tip[cut])
            for part, cut in (("ring_down", slice(0, 1250)), ("later", slice(1250, None)))}


def torque_pendulum(folder: Path) -> dict[str, Columns]:
    """Columns: time, angle, velocity, torque. The velocity, which the motor reports, is left out;
    the time stamps are those of the logger."""
    parts = {}
    for name in ("energy_shaping", "sac"):
        data = np.loadtxt(folder / f"{name}.csv", delimiter=",", skiprows=1)
        parts[name] = {"time_s": data[:, 0], "input_Nm": data[:, 3], "position_rad": data[:, 1]}
    return parts


def swing_up(folder: Path) -> dict[str, Columns]:
    """The first seconds of both: swing-ups, before the pendulum is pushed."""
    ends = {"energy_shaping": 5.0, "sac": 15.0}
    return {part: {name: values[columns["time_s"] < ends[part]]
                   for name, values in columns.items()}
            for part, columns in torque_pendulum(folder).items()}


def _ecp(folder: Path, name: str) -> dict[str, Columns]:
    """Columns: sample, time, wanted position, encoders, command. Times are rounded to a
    millisecond, so that the period is that of all of them."""
    parts = {}
    for number in range(1, 6):
        text = (folder / f"{name}_test{number}.csv").read_text("utf-8").split("[", 1)[1]
        data = np.array([line.split() for line in text.split("]")[0].split(";")], float)
        parts[f"test_{number}"] = timed(float(data[-1, 1]) / (len(data) - 1),
                                         input_v=data[:, -1], position_m=1e-6 * data[:, 3])
    return parts


def two_masses(folder: Path) -> dict[str, Columns]:
    """The driven carriage; the second encoder is left out."""
    return _ecp(folder, "DOF2_en12_input1")


def one_mass(folder: Path) -> dict[str, Columns]:
    """The driven carriage, the other one held."""
    return _ecp(folder, "DOF1_en1_input1")


def relay_cart(folder: Path) -> dict[str, Columns]:
    """Columns: time, motor current, position, velocity (a difference of the position). The first
    row comes a fraction of a period before the second, and is left out."""
    parts = {}
    for place in (30, 40, 35):
        data = np.loadtxt(folder / f"0m{place}.csv", delimiter=",", skiprows=1)
        parts[f"at_{place}_cm"] = {"time_s": data[:, 0], "input_a": data[:, 1],
                                   "position_m": data[:, 2]}
    return parts


def flexible_link(folder: Path) -> dict[str, Columns]:
    """Columns: time, sample, reference, drive, angle of the motor, acceleration of the beam. The
    encoder has 1024 counts a turn; the reference is in its counts. Counts of the drive stand as
    volts."""
    parts = {}
    for part, run in (("wide_1", "75_stopn=10000_test_1"), ("wide_2", "75_stopn=10000_test_2"),
                      ("narrow_1", "50_stopn=10000_test_1")):
        name = f"swept_sine_no_sat_amp={run}_SLFR_RTP_P_control_kp=1.0.txt"
        data = np.loadtxt(folder / name)
        parts[part] = {"time_s": data[:, 0], "input_v": data[:, 3],
                       "position_rad": 2.0 * np.pi / 1024.0 * data[:, 4],
                       "reference_rad": 2.0 * np.pi / 1024.0 * data[:, 2]}
    return parts


def _captured(path: Path) -> tuple[Array, list[Array]]:
    """Times and columns of a dSPACE capture, which is named like its file."""
    data = scipy.io.loadmat(path, squeeze_me=True, struct_as_record=False)[path.stem]
    return np.asarray(data.X.Data, float), [np.asarray(each.Data, float) for each in data.Y]


def linear_guide(folder: Path) -> dict[str, Columns]:
    """Columns: encoders of both carriages (mm), motor command. The driven one, from 10 to 50 s,
    every fourth sample; the input ends at 20 Hz."""
    parts = {}
    for number in (1, 4):
        time, (driven, _, volts) = _captured(folder / f"exp{number}.mat")
        cut = slice(10_000, 50_000, 4)
        parts[f"run_{number}"] = {"time_s": time[cut], "input_v": volts[cut],
                                  "position_m": 1e-3 * driven[cut]}
    return parts


def struck_beam(folder: Path) -> dict[str, Columns]:
    """Time and value, seven lines of head: hammer force and beam velocity, the first second."""
    parts = {}
    for part, name in (("hard", "mec-t2"), ("soft", "mec-t3")):
        force, velocity = (np.loadtxt(folder / f"{name}-{what}.txt", skiprows=7,
                                      max_rows=10_000)[:, 1] for what in ("force", "velocity"))
        parts[part] = timed(1e-4, input_N=force, velocity_m_s=velocity)
    return parts


def crane_cart(folder: Path) -> dict[str, Columns]:
    """Columns: cable angle, cart (counts), its speed, command twice. The second period of the
    input; scale of the cart and sign of the command as the source has them."""
    parts = {}
    for number in (1, 2):
        time, columns = _captured(folder / f"meas{number}.mat")
        cut = slice(8192, 16_384)
        parts[f"run_{number}"] = {"time_s": time[cut], "input_v": -columns[3][cut],
                                  "position_m": 0.035 * np.pi / 9000.0 * columns[1][cut]}
    return parts


def walker_leg(folder: Path) -> dict[str, Columns]:
    """Voltage and angle (degrees). The free swing and three steps, then the sweep until the leg
    hardly moves any more."""
    path = folder / "realVSmodel_fwAnd5vstepsx3AndChirp_innerSW.mat"
    names = ("datatimeall", "datainall", "dataoutall")
    data = scipy.io.loadmat(path, squeeze_me=True, variable_names=names)
    time, volts, angle = (np.asarray(data[name], float) for name in names)
    return {part: {"time_s": time[cut], "input_v": volts[cut],
                   "position_rad": np.radians(angle[cut])}
            for part, cut in (("swing_and_steps", slice(0, 7560)),
                              ("sweep", slice(7560, 11_600)))}


def sprung_carts(folder: Path) -> dict[str, Columns]:
    """Voltage and speeds of both carts (mm/s). The driven one, every second sample."""
    parts = {}
    for part, name in (("square_low", "1_5"), ("sine_2_hz", "sine_2"), ("square_high", "2"),
                       ("sine_3_hz", "sine_3")):
        path = folder / f"velocity_response_{name}.mat"
        time, volts, speed = (np.asarray(matlab(path, column), float)[::2]
                              for column in ("t", "u", "v1"))
        parts[part] = {"time_s": time, "input_v": volts, "velocity_m_s": 1e-3 * speed}
    return parts


def ruler_arm(folder: Path) -> dict[str, Columns]:
    """Columns: time (ms), angle of the hub, deflection of the tip, their speeds, wanted angle,
    voltage, gains. Every second sample; the reference is that of the hub alone."""
    parts = {}
    for number in (2, 3, 4):
        data = np.loadtxt(folder / f"flexibleArm_test_{number}", comments="%")[::2]
        parts[f"run_{number}"] = {"time_s": 1e-3 * (data[:, 0] - data[0, 0]),
                                  "input_v": data[:, 6], "position_rad": data[:, 1],
                                  "reference_rad": data[:, 5]}
    return parts


def piezo_actuator(folder: Path) -> dict[str, Columns]:
    """Columns: none, time, displacement (um), voltage. Six periods, every tenth sample."""
    data = np.genfromtxt(folder / "hysteresis_v_150_1hz.csv", delimiter=",")[20_000:50_000:10]
    return {part: {"time_s": data[cut, 1], "input_v": data[cut, 3],
                   "position_m": 1e-6 * data[cut, 2]}
            for part, cut in (("four_periods", slice(0, 2000)),
                              ("two_periods", slice(2000, None)))}


def ball_on_beam(folder: Path) -> dict[str, Columns]:
    """Columns: angle of the beam, position of the ball; halves as others split it. The angle
    stands as volts."""
    data = np.loadtxt(folder / "ball-and-beam.csv", delimiter=",", skiprows=1)
    return {part: timed(0.1, input_v=data[cut, 0], position_m=data[cut, 1])
            for part, cut in (("first_half", slice(0, 500)), ("second_half", slice(500, 1000)))}


def steel_link(folder: Path) -> dict[str, Columns]:
    """Voltage; wanted and measured angle of the hub (degrees)."""
    volts, angle = (np.asarray(matlab(folder / f"data_{name}.mat", f"data_{name}"), float)
                    for name in ("vm", "theta"))
    return {part: {"time_s": volts[cut, 0], "input_v": volts[cut, 1],
                   "position_rad": np.radians(angle[cut, 2]),
                   "reference_rad": np.radians(angle[cut, 1])}
            for part, cut in (("first", slice(0, 1600)), ("last", slice(1600, 2500)))}


def belt_drive(folder: Path) -> dict[str, Columns]:
    """Columns: sample, time, wanted count, counts of drive and load, drive (V)."""
    text = (folder / "6.6_data.m").read_text("latin-1").partition("[")[2].partition("]")[0]
    data = np.array([row.split() for row in text.split(";") if row.strip()], float)
    counts_per_rad = 2546.5
    return {part: timed(data[-1, 1] / data[-1, 0], input_v=data[cut, 5],
                         position_rad=data[cut, 3] / counts_per_rad,
                         reference_rad=data[cut, 2] / counts_per_rad)
            for part, cut in (("first", slice(0, 3953)), ("last", slice(3953, None)))}


def _stacked(folder: Path, name: str, count: int) -> Array:
    """A run that its logger has cut into files."""
    return np.vstack([np.loadtxt(folder / f"{name}_data{k:04d}.txt") for k in range(count)])


def motor_cart(folder: Path) -> dict[str, Columns]:
    """Columns: voltage, current (10 Hz), position (559 steps a cm). Without the first 2 s, where
    the drive is off. The cart moves against the sign of the voltage: the position is turned
    round."""
    data = _stacked(folder, "rand_kmed_2mass", 4)
    return {part: timed(5e-3, input_v=data[cut, 0], position_m=-data[cut, 2] / 55_900.0)
            for part, cut in (("first", slice(400, 5200)), ("rest", slice(5200, None)))}


def two_sprung_carts(folder: Path) -> dict[str, Columns]:
    """Columns: current, position of the first and of the second cart (cm), voltage. Two bursts,
    the position of the first cart turned round."""
    data = _stacked(folder, "KhKm-noM-noM", 2)
    return {part: timed(5e-3, input_a=data[cut, 0], position_m=-0.01 * data[cut, 1])
            for part, cut in (("first", slice(900, 2900)), ("rest", slice(2900, None)))}


def _joint(path: Path) -> Columns:
    """Voltage, angle of the motor, and wanted angle. Every second sample."""
    data = scipy.io.loadmat(path, squeeze_me=True)
    return timed(4e-3, input_v=data["u"][::2], position_rad=data["Theta"][::2],
                  reference_rad=data["r"][::2])


def joint_arm(folder: Path) -> dict[str, Columns]:
    """The angle of the arm against the motor is left out."""
    return {"long": _joint(folder / "Joint_SI_CL_40s_Data.mat"),
            "short": _joint(folder / "Joint_SI_CL_Data.mat")}


def bare_joint(folder: Path) -> dict[str, Columns]:
    """The first 60 % and the rest of one period of 40 s."""
    data = _joint(folder / "Joint_SI_CL_40s_noarm_Data.mat")
    return parts_of(data, {"first": slice(0, 6000), "last": slice(6000, None)})


READERS: dict[str, Reader] = {reader.__name__: reader for reader in (
    *FREE_SWINGS, *MOTORS, silverbox, emps, motor_bench, beam, quarter_drone, pendulum,
    aero_pendulum, harvester, double_beam, robot_arm, servo_link, torque_pendulum, swing_up,
    two_masses, one_mass, relay_cart, flexible_link, linear_guide, struck_beam, crane_cart,
    walker_leg, sprung_carts, ruler_arm, piezo_actuator, ball_on_beam, steel_link, belt_drive,
    motor_cart, two_sprung_carts, joint_arm, bare_joint)}


def write_csv(path: Path, columns: Columns) -> None:
    """Write columns as a CSV file that `read_record` takes."""
    np.savetxt(path, np.column_stack(list(columns.values())), fmt="%.12g", delimiter=",",
               header=",".join(columns), comments="")
