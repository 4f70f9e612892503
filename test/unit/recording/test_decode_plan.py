"""The program for a message type, read against the serialised form by hand."""

from __future__ import annotations

from dfm_stage.recording.decode_plan import MOST_INSTRUCTIONS, Column, Op, compile_plan
from dfm_stage.recording.message_definitions import parse_schema
from dfm_stage.recording.topic_arrays import TopicArrays


def plan_of(*lines: str):
    parts = ("\n".join(lines) + "\n").split("---\n")
    return compile_plan(parse_schema(("=" * 80 + "\n").join(parts), "t/msg/M"), "t/msg/M")


def test_a_fixed_array_is_one_instruction_with_alignment_and_count():
    plan = plan_of("float64[3] a", "string b", "builtin_interfaces/Time c")
    assert plan.instructions == [(Op.COPY, 8, 3, 0), (Op.STRING, 4, 1, 1), (Op.TIME, 4, 1, 2)]
    assert plan.fixed == [Column("a", "f8", 3), Column("b", ""), Column("c", "i8")]


def test_a_sequence_of_messages_is_a_loop_and_its_fields_are_ragged():
    plan = plan_of("P[] p", "---", "MSG: t/P", "int16 a", "string b", "float32[] c")
    assert plan.instructions == [
        (Op.LOOP, 0, 0, 4), (Op.COPY, 2, 1, 0), (Op.STRING, 4, 1, 1), (Op.SEQUENCE, 4, 0, -1),
        (Op.END, 0, 0, -4), (Op.REST, 0, 0, -1)]
    assert plan.ragged == [Column("p.a", "i2"), Column("p.b", "")]
    assert plan.left_out == ["p.c: a sequence inside a sequence"]


def test_what_cannot_be_located_ends_the_program_and_leaves_no_half_of_a_loop():
    plan = plan_of("uint8 a", "P[2] p", "uint8 z", "---", "MSG: t/P", "int16 a", "wstring b")
    assert plan.instructions == [(Op.COPY, 1, 1, 0), (Op.REST, 0, 0, -1)]
    assert plan.ragged == []
    assert "wide strings" in plan.left_out[0]
    assert plan.left_out[0].startswith("p and what follows")


def test_messages_that_multiply_end_the_program():
    """Eight messages in each of eight levels would be sixteen million fields."""
    parts = []
    for level in range(8):
        parts += ["---", f"MSG: t/L{level}", *(
            f"L{level + 1} f{k}" if level < 7 else f"uint8 f{k}" for k in range(8))]
    plan = plan_of("L0 a", *parts)
    assert len(plan.instructions) <= MOST_INSTRUCTIONS + 1
    assert f"more than {MOST_INSTRUCTIONS} fields" in plan.left_out[0]


def test_a_topic_that_claims_more_than_the_memory_is_left_out_field_by_field():
    arrays = TopicArrays("/a", "t/msg/M", plan_of("uint8[4000000000] a"), 1 << 20)
    assert arrays.finish().left_out == ["all fields: they need more memory than there is"]
