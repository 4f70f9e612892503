"""The recorder asks each of its subscriptions every 10 ms: all at once, or in shares where it has
its process together with a loop."""

from __future__ import annotations

import pytest

from dfm_stage.middleware.hand_over import handing_over, hands_over
from dfm_stage.nodes.process import make_executor
from dfm_stage.nodes.recorder import Recorder
from dfm_stage.recording.bag_writer import CHUNK_BYTES


@pytest.fixture(params=[False, True])
def recorder(request, tmp_path, ros):
    """A recorder, beside a loop or not."""
    context = ros()
    executor = make_executor(context)

    def made():
        return Recorder(context=context, cli_args=[
            "--ros-args", "-p", f"bag:='{tmp_path / 'bag'}'", "-p", "topics:=none"])

    if request.param:
        with handing_over(context, executor):
            node = made()
            yield node
            node.destroy_node()
    else:
        node = made()
        yield node
        node.destroy_node()


def test_chunks_are_small_beside_a_loop_in_real_time(recorder):
    assert (recorder._bag._chunk_bytes < CHUNK_BYTES) == hands_over(recorder)


def test_each_subscription_is_asked_once_in_ten_milliseconds(recorder):
    asked = []

    class Tap:
        number = 1
        echoes = ()

    for index in range(12):
        recorder._taps.append((lambda *_, index=index: asked.append(index), None, Tap(), False))
    times = {timer.callback.__name__ if hasattr(timer.callback, "__name__")
             else timer.callback.args[0].__name__: round(10e6 / timer.timer_period_ns)
             for timer in recorder.timers}
    assert times["_fetch_share"] == times["_write"]
    per_call = []
    for _ in range(times["_fetch_share"]):
        before = len(asked)
        recorder._fetch_share()
        per_call.append(len(asked) - before)
    assert sorted(asked) == list(range(12))
    assert max(per_call) - min(per_call) <= 1
    recorder._taps.clear()
