"""Experiments: what a file says arrives, and what is wrong in it is named with its line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dfm_stage.trajectory import TrajectoryError, load_experiment

GOOD = """\
name: wobble            # a comment
mode: pid
duration_s: 2
model: paper_stage
controller: {kp: 1.0e+3}
seed: 7
axes:
  x:
    reference: {kind: raster, line_time_s: 0.4}
    excitation:
      kind: multisine
      period_s: 1.0
      odd: true
  y:
"""


def test_a_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "wobble.yaml"
    path.write_text(GOOD)
    e = load_experiment(path)
    assert (e.name, e.mode, e.duration_s, e.model, e.seed) == ("wobble", "pid", 2.0,
                                                               "paper_stage", 7)
    assert e.controller == {"kp": 1000.0}
    assert set(e.axes) == {"x", "y"}
    assert type(e.axes["x"].excitation) is dict
    assert e.reference("x", 1e-3).position.shape == (2000,)
    assert e.excitation("x", 1e-3).period_samples == 1000
    assert not e.excitation("y", 1e-3).voltage.any()
    assert e.source == str(path)
    assert (e.bounds.error_rms_m, e.bounds.output_on) == (None, True)
    path.write_text(f"{GOOD}bounds: {{error_rms_m: 2.0e-6, output_on: false}}\n")
    bounds = load_experiment(path).bounds
    assert (bounds.error_rms_m, bounds.error_peak_m, bounds.output_on) == (2e-6, None, False)


def test_axes_get_different_phases_and_the_seed_decides() -> None:
    spec = {"kind": "multisine", "period_s": 1.0}
    content: dict[str, Any] = {"name": "n", "mode": "open_loop", "duration_s": 1.0,
                               "axes": {"x": {"excitation": spec}, "y": {"excitation": spec}}}
    one, two = load_experiment(content), load_experiment({**content, "seed": 1})
    x, y = (one.excitation(axis, 1e-3).voltage for axis in "xy")
    assert not np.allclose(x, y)
    assert not np.allclose(x, two.excitation("x", 1e-3).voltage)
    assert np.array_equal(x, load_experiment(content).excitation("x", 1e-3).voltage)


@pytest.mark.parametrize(("old", "new", "line", "part"), [
    ("mode: pid", "mode: p d", 2, "mode must be open_loop or the name of a control law"),
    ("duration_s: 2", "duration: 2", 3, "no entry 'duration', did you mean 'duration_s'?"),
    ("duration_s: 2", "duration_s: -2", 3, "duration_s must be a number of seconds"),
    ("seed: 7", "seed: x", 6, "seed must be a whole number"),
    ("odd: true", "od: true", 13, "did you mean 'odd'?"),
    ("period_s: 1.0", "period_s: -1.0", 12, "axes.x.excitation: period_s = -1 s is outside"),
    ("kind: raster", "kind: rastr", 9, "did you mean 'raster'?"),
    ("    excitation:", "    excitations:", 10, "did you mean 'excitation'?"),
    ("mode: pid", "mode: open_loop", 9, "axes.x.reference has no effect with mode: open_loop"),
    ("  y:", "  y: 3", 14, "axes.y must hold reference and/or excitation"),
    ("name: wobble ", "name: 3 ", 1, "name: must be text"),
    ("controller: {kp: 1.0e+3}", "controller: 3", 5, "controller must be a file name"),
    ("seed: 7", "seed: 7: 8", 6, "not valid YAML"),
    ("seed: 7", "mode: pid", 6, "not valid YAML"),
    ("seed: 7", "bounds: tight", 6, "bounds must be a mapping"),
    ("seed: 7", "bounds: {error_rms: 1e-6}", 6, "did you mean 'error_rms_m'?"),
    ("seed: 7", "bounds: {error_peak_m: -1e-6}", 6, "bounds.error_peak_m must be a number of"),
    ("seed: 7", "bounds: {output_on: 1}", 6, "bounds.output_on must be true or false"),
])
def test_what_is_wrong_is_named_with_file_and_line(tmp_path: Path, old: str, new: str, line: int,
                                                   part: str) -> None:
    assert old in GOOD
    path = tmp_path / "bad.yaml"
    path.write_text(GOOD.replace(old, new))
    with pytest.raises(TrajectoryError) as caught:
        load_experiment(path)
    message = str(caught.value)
    assert message.startswith(f"{path}:{line}: ")
    assert part in message
    assert "\n" not in message


@pytest.mark.parametrize("content", ["", "- 1\n", "just text\n"])
def test_something_that_is_no_experiment(tmp_path: Path, content: str) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(content)
    with pytest.raises(TrajectoryError, match="an experiment is a mapping"):
        load_experiment(path)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(TrajectoryError, match="no such experiment file"):
        load_experiment(tmp_path / "absent.yaml")
    with pytest.raises(TrajectoryError, match="cannot read the experiment"):
        load_experiment(tmp_path)
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(TrajectoryError, match="not UTF-8"):
        load_experiment(tmp_path / "binary.yaml")


def test_an_unknown_axis_and_missing_parts() -> None:
    content: dict[str, Any] = {"name": "n", "mode": "pid", "duration_s": 1.0, "axes": {"x": None}}
    with pytest.raises(TrajectoryError, match="no axis 'z'"):
        load_experiment(content).reference("z", 1e-3)
    for key in ("name", "mode", "duration_s", "axes"):
        with pytest.raises(TrajectoryError, match=key):
            load_experiment({k: v for k, v in content.items() if k != key})
