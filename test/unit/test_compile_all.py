"""What compile_all compiles is all there is to compile, for every process and every copy."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
USE = """
import numpy as np
from dfm_stage.model import EFFECTS, CoupledPlant, EffectUse, Model, Simulator, load_model
from dfm_stage.model.kernel import hooks, record, setup
from dfm_stage.recording import BagWriter, read_bag, record_kernels, decode_kernels
import pathlib, sys, tempfile

made, code = [], hooks.callback
hooks.callback = lambda *given: made.append(code(*given)) or made[-1]
frozen = np.ones(64)
frozen.flags.writeable = False
for model in (load_model("paper_stage"), load_model("paper_two_mode"), load_model("xy_stage")):
    plant = CoupledPlant(model, seed=3)
    plant.sample()
    plant.advance([1] * len(plant.plants), np.ones(len(plant.plants)))
    plant.plants[0].reset(past_input=0)
    plant.sample()
base = {"mass": 1, "damping": 2, "stiffness": 600, "delay": 0.0015}
effects = {"cubic_stiffness": {}, "coulomb_friction": {}, "hysteresis": {}, "second_mode": {},
           "cross_axis_coupling": {}, "encoder_quantization": {}, "periodic_disturbance": {},
           "thermal_drift": {}}
for chosen in ((), tuple(effects)):
    uses = tuple(EffectUse(n, EFFECTS[n].defaults) for n in chosen)
    model = Model("m", 1e-3, base=base, effects=uses)
    simulator = Simulator(model)
    other = {"other": frozen} if chosen else {}
    simulator.run(frozen, external_force=frozen, past_input=1, **other)
    simulator.output(frozen.astype(np.float32), initial={"position": 1}, **other)
    simulator.run_many(list(frozen), ["mass"], [[1], [2]], threads=2, **other)
    simulator.sensitivities(frozen[::2], ["mass", "delay"],
                            **({"other": frozen[::2]} if chosen else {}))
    if not chosen:
        simulator.output(frozen, steady_state=True)
assert "numba.np.arraymath" not in sys.modules      # what only compiling needs
with tempfile.TemporaryDirectory() as folder:
    for compression in ("zstd", "none"):
        writer = BagWriter(pathlib.Path(folder) / compression, compression=compression)
        topic = writer.add_topic("/t", "std_msgs/msg/String", (), "", "string data\\n")
        writer.write(topic, bytes(4) + bytes([2, 0, 0, 0]) + b"a" + bytes(1), 0, 0)
        writer.close()
        read_bag(writer.directory)
assert len(made) == 9, made
assert all(each.cache_hits == 1 for each in made)
for function in (record.run, record.peek, setup.prepare, setup.reset, setup.restart,
                 record_kernels.locate, decode_kernels.decode):
    stats = function.stats
    assert not sum(stats.cache_misses.values()), (function, stats)
    assert len(function.signatures) == 1, (function, function.signatures)
assert "scipy.linalg" not in sys.modules
"""


@pytest.mark.slow
def test_a_second_process_and_a_copy_compile_nothing(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "dfm_stage", tmp_path / "dfm_stage",
                    ignore=shutil.ignore_patterns("__pycache__"))
    for code, folder in (("from dfm_stage.compile_all import compile_all; compile_all()", ROOT),
                         (USE, ROOT), (USE, tmp_path)):
        done = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True,
                              env={**os.environ, "PYTHONPATH": str(folder)}, text=True,
                              check=False)
        assert done.returncode == 0, done.stderr
