"""Options of the commands that take records: parts, splits, conventions, fields of bags."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dfm_stage import __main__
from dfm_stage.cli import bags, characterize, diagnose, identify, tune
from dfm_stage.cli.command import command_parser, option
from dfm_stage.cli.records import RECORDS, SPLIT, as_words, divided, held_names, read_with
from dfm_stage.errors import DfmError
from dfm_stage.model import Simulator, load_model
from dfm_stage.recording import AxisRecord, BagWriter, Provenance, Record, read_record, write_csv

COUNT = 4000


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The paper's stage shaken for 4 s, from 10 s on."""
    rng = np.random.default_rng(5)
    drive = np.repeat(rng.choice([-0.3, 0.3], COUNT // 20), 20).astype(float)
    reading = Simulator(load_model("paper_stage")).run(drive).measured(1)
    path = tmp_path_factory.mktemp("log") / "log.csv"
    write_csv(Record(10.0 + 1e-3 * np.arange(COUNT), 1e-3, {"x": AxisRecord(drive, reading)},
                     Provenance("", "csv")), path)
    return path


def parsed(*words: str) -> argparse.Namespace:
    return command_parser("test", None, "", (option("--free"), SPLIT, *RECORDS)).parse_args(words)


def test_a_part_in_seconds_or_in_samples(log: Path) -> None:
    whole = read_record(log).axis()
    for words, part in ((("--from", "0.5", "--to", "2"), slice(500, 2000)),
                        (("--from", "1.25"), slice(1250, None)), (("--to", "0.003"), slice(3)),
                        (("--rows", "100:250"), slice(100, 250)), (("--rows", ":50"), slice(50)),
                        (("--rows", "3990:"), slice(3990, None)),
                        (("--to", "99"), slice(None)), (("--rows", "0:99999"), slice(None))):
        record = read_with(parsed(*words), str(log))
        assert record.axis().position.tolist() == whole.position[part].tolist(), words
        assert any("were used" in text for text in record.warnings)


@pytest.mark.parametrize("words", [
    "--from 4", "--from -1", "--from 2 --to 1", "--from 1 --to 1", "--to 0", "--from nan",
    "--from 1 --to 1.001", "--rows 5", "--rows 5:2", "--rows -3:9", "--rows a:b",
    "--rows 4000:5000", "--rows 4:4", "--rows 0:9 --from 1", "--input-shift soon",
    "--input-shift nan"])
def test_an_impossible_part_is_one_line(log: Path, words: str,
                                        capsys: pytest.CaptureFixture[str]) -> None:
    split = [word.replace(" ", "=", 1) for word in f" {words}".split(" --") if word]
    assert identify.main([str(log), *(f"--{word.strip()}" for word in split)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_hole_elsewhere_does_not_move_a_part(tmp_path: Path, log: Path) -> None:
    lines = log.read_text().splitlines()
    path = tmp_path / "holes.csv"
    path.write_text("\n".join(lines[:101] + lines[111:]) + "\n")      # 10 samples are missing
    whole = read_record(log).axis().position
    record = read_with(parsed("--rows", "200:300"), str(path))
    assert record.axis().position.tolist() == whole[200:300].tolist()
    record = read_with(parsed("--rows", "50:300"), str(path))
    assert record.axis().position.tolist() == whole[110:300].tolist()


def test_what_a_logger_dropped_may_be_filled_in(tmp_path: Path, log: Path) -> None:
    """0.1 % of the samples are missing; their stamps show it."""
    lines = log.read_text().splitlines()
    lost = {600, 1400, 2222, 3500}
    path = tmp_path / "dropped.csv"
    path.write_text("\n".join(line for k, line in enumerate(lines) if k - 1 not in lost) + "\n")
    whole = read_record(log).axis()
    longest = read_with(parsed(), str(path))
    assert longest.axis().position.tolist() == whole.position[2223:3500].tolist()
    assert any("4 samples are missing" in text for text in longest.warnings)
    for words, part in ((("--gaps", "fill"), slice(None)),
                        (("--gaps", "fill", "--rows", "500:1000"), slice(500, 1000))):
        record = read_with(parsed(*words), str(path))
        assert record.axis().position == pytest.approx(whole.position[part], abs=1e-6)
        assert any("were filled in; estimated error" in text for text in record.warnings)


def test_the_convention_reaches_the_record(log: Path) -> None:
    for words, hold, shift in (((), None, None), (("--input-shift", "-1"), None, -1.0),
                               (("--input-hold", "first", "--input-shift", "0.5"), "first", 0.5),
                               (("--input-hold", "auto", "--input-shift", "auto"), None, None)):
        axis = read_with(parsed(*words), str(log)).axis()
        assert (axis.input_hold, axis.input_shift) == (hold, shift)


def test_a_record_is_brought_to_the_period_asked_for(log: Path) -> None:
    record = read_with(parsed(), str(log), period=1.02e-3)
    assert record.sample_period == 1.02e-3
    assert any("resampled" in text for text in record.warnings)


def test_a_split_holds_out_the_rest(log: Path) -> None:
    record = read_with(parsed(), str(log))
    options = parsed("--split", "0.75")
    (first,), (rest,) = divided(options, [record], [])
    assert (len(first), len(rest)) == (3000, 1000)
    assert held_names(options, ["log.csv"], []) == ["log.csv (rest)"]
    with pytest.raises(DfmError, match="give one of them"):
        divided(options, [record], [record])
    assert divided(parsed(), [record], [rest]) == ([record], [rest])


def test_options_can_be_handed_on() -> None:
    words = ["--from=0.5", "--input=a b", "--input-shift=-1", "--rows=1:3"]
    assert as_words(parsed(*words), *RECORDS) == ["--input=a b", "--from=0.5", "--rows=1:3",
                                                  "--input-shift=-1"]


@pytest.mark.parametrize("tool", [bags, characterize, diagnose, identify, tune])
def test_every_command_that_takes_records_has_the_options(tool: Any) -> None:
    titles = {entry[0] for entry in tool.OPTIONS if isinstance(entry[0], str)}
    assert titles >= {title for title, _ in RECORDS}


def test_identify_holds_out_what_a_split_leaves(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert identify.main([str(log), "--model", "paper_stage", "--split", "0.75", "--from", "0.2",
                          "--no-report", "--out", str(out)]) == 0
    found = json.loads((out / "identify.json").read_text())
    assert found["held_out"]["source"] == "log.csv (rest)"
    assert any("split at 0.75: samples 0 to 2849 of 3800" in text for text in found["warnings"])
    gain = found["parameters"]["stiffness"]["value"]
    assert gain == pytest.approx(650.0, rel=0.02)


def test_logs_of_different_jittered_rates_are_fitted_together(
        log: Path, tmp_path: Path) -> None:
    """A second log of the same stage at 1.02 ms, jittered; its model steps by 1 ms."""
    rng = np.random.default_rng(8)
    model = load_model("paper_stage")
    count, fine = 3000, 51          # 1.02 ms in steps of 20 us
    drive = np.repeat(rng.choice([-0.3, 0.3], count // 20), 20).astype(float)
    steps = Simulator(replace(model, sample_period=2e-5)).run(np.repeat(drive, fine)).measured(3)
    late = rng.integers(0, 3, count)        # up to 4 % of a period
    taken = np.minimum(fine * np.arange(count) + late, fine * count - 1)
    other = tmp_path / "other.csv"
    other.write_text("\n".join(["time_s,input_v,position_m", *(
        f"{2e-5 * k:.9f},{u!r},{y!r}" for k, u, y in zip(
            taken.tolist(), drive.tolist(), steps[taken].tolist(), strict=True))]) + "\n")
    assert identify.main([str(log), str(other), "--model", "paper_stage", "--no-report",
                          "--out", str(tmp_path / "out")]) == 0
    found = json.loads((tmp_path / "out" / "identify.json").read_text())
    assert any("resampled from every 0.00102" in text for text in found["warnings"])
    assert found["parameters"]["stiffness"]["value"] == pytest.approx(650.0, rel=0.02)
    fits = {each["source"]: each["fit_percent"] for each in found["fits"]}
    assert fits["other.csv"] > 98.0


def test_a_diagnosis_takes_records_at_their_own_period(tmp_path: Path) -> None:
    """Two records at 1.02 ms; the model steps by 1 ms, and goes on to do so."""
    rng = np.random.default_rng(9)
    model = load_model("paper_stage")
    stage = Simulator(replace(model, sample_period=1.02e-3, base={
        **model.base, "stiffness": 1.1 * model.base["stiffness"]}))
    for name in ("fitted", "held"):
        drive = np.repeat(rng.choice([-0.3, 0.3], 100), 20).astype(float)
        write_csv(Record(1.02e-3 * np.arange(2000), 1.02e-3, {
            "x": AxisRecord(drive, stage.run(drive).measured(4))}, Provenance("", "csv")),
            tmp_path / f"{name}.csv")
    out = tmp_path / "out"
    assert diagnose.main([str(tmp_path / "fitted.csv"), "--holdout", str(tmp_path / "held.csv"),
                          "--model", "paper_stage", "--no-report", "--out", str(out)]) == 0
    found = json.loads((out / "diagnosis.json").read_text())
    low, high = found["base"]["stiffness"]["ci95"]
    assert low < 1.1 * model.base["stiffness"] < high
    assert found["verdict"] == "retune"
    assert not any("resampled" in text for text in found["warnings"])
    assert "fitted at the records' own period of 0.00102 s, not at the model's 0.001 s" \
        in found["warnings"]
    assert load_model(out / "model.yaml").sample_period == model.sample_period


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    """A bag of two topics of numbers."""
    with BagWriter(tmp_path / "bag") as bag:
        topics = [bag.add_topic(name, "std_msgs/msg/Float64", [], "", "float64 data\n")
                  for name in ("/force", "/place")]
        for k in range(400):
            for topic, value in zip(topics, (np.cos(0.1 * k), np.sin(0.1 * k)), strict=True):
                data = b"\0\1\0\0" + np.float64(value).tobytes()
                bag.write(topic, data, 10**18 + k * 10**6, 10**18 + k * 10**6, k)
    return tmp_path / "bag"


def test_bags_lists_and_exports(foreign: Path, tmp_path: Path,
                                capsys: pytest.CaptureFixture[str]) -> None:
    assert __main__.main(["bags", str(foreign)]) == 0
    said = capsys.readouterr().out
    assert "/force  (std_msgs/msg/Float64): 400 messages, 1000 Hz, no header" in said
    assert "/place.data  float64  -0.99" in said
    assert f"./run identify {foreign} --input FIELD --output FIELD" in said
    assert __main__.main(["bags", str(foreign), "--json", "--topic", "/pl*"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [topic["name"] for topic in found["topics"]] == ["/place"]
    assert found["topics"][0]["rate_hz"] == pytest.approx(1000.0)
    fields = ["--input", "/force.data", "--output", "/place.data", "--output-unit", "mm",
              "--rows", "100:200"]
    for name in ("run.csv", "run.npz", "run.mat"):
        assert __main__.main(["bags", str(foreign), *fields, "--export",
                              str(tmp_path / name)]) == 0
        axis = read_record(tmp_path / name).axis()
        assert axis.position == pytest.approx(1e-3 * np.sin(0.1 * np.arange(100, 200)))
        assert axis.input == pytest.approx(np.cos(0.1 * np.arange(100, 200)))
    capsys.readouterr()
    for words in (["absent"], [str(foreign), "--export", "run.txt"],
                  [str(foreign), "--export", "run.csv"], [str(foreign), "--topic", "/absent"]):
        assert __main__.main(["bags", *words]) == 2
        assert capsys.readouterr().err.count("\n") == 1
