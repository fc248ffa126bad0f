import struct

import pytest
from hypothesis import given, strategies as st

from jaxcell.robot.create.open_interface import (
    HEADER,
    RESET,
    SAFE,
    START,
    STOP,
    Command,
    CommandParser,
    StreamParser,
    drive_direct,
    stream,
    stream_frame,
    wheel_speeds,
)
from jaxcell.robot.create.packets import (
    GROUPS,
    PACKETS,
    Contact,
    encode,
    encoder_difference,
    layout,
    members,
)
from jaxcell.robot.create.reading import STREAM


# The sizes of the packets 7 to 58, read again from the table of the specification.
SIZES = [1] * 12 + [2, 2, 1, 2, 2, 1, 2, 2] + [2] * 5 + [1, 2, 1, 1, 1, 1, 1] + [2] * 6
SIZES += [1, 2, 2, 2, 2, 2, 2, 1, 1, 2, 2, 2, 2, 1]


# Strategies call no function of the package, because beartype draws random numbers, which
# hypothesis forbids.
def values_of(ids):
    """Values in range for the packets `ids`, by name."""
    packets = [PACKETS[i] for i in ids]
    return st.fixed_dictionaries(
        {p.name: st.integers(p.low, p.high) | st.just(min(HEADER, p.high)) for p in packets}
    )


lists_of_ids = st.lists(st.sampled_from(sorted(PACKETS)), min_size=1, max_size=20)


def test_commands_have_the_bytes_of_the_specification():
    assert drive_direct(right=1, left=-2) == bytes([145, 0, 1, 255, 254])
    assert stream([29, 13]) == bytes([148, 2, 29, 13])
    assert b"".join((RESET, START, SAFE, STOP)) == bytes([7, 128, 131, 173])
    bits = ["BUMP_RIGHT", "BUMP_LEFT", "WHEEL_DROP_RIGHT", "WHEEL_DROP_LEFT"]
    assert [Contact(1 << bit).name for bit in range(4)] == bits


def test_a_frame_has_the_bytes_of_the_specification():
    frame = bytes([19, 5, 29, 2, 25, 13, 0, 163])
    values = {"cliff_front_left_signal": 0x0219, "virtual_wall": 0}
    assert StreamParser([29, 13]).feed(frame) == [values]
    assert stream_frame([29, 13], values) == frame


def test_packets_and_groups_have_the_sizes_of_the_specification():
    assert [PACKETS[i].size for i in range(7, 59)] == SIZES
    sums = {0: 26, 1: 10, 2: 6, 3: 10, 4: 14, 5: 12, 6: 52, 100: 80, 101: 28, 106: 12, 107: 9}
    assert {group: layout([group]).size for group in GROUPS} == sums
    assert all(members((group,)) == members(tuple(ids)) for group, ids in GROUPS.items())


def test_signed_and_unsigned_values_are_big_endian():
    values = {"current": -300, "temperature": -5, "charge": 65000}
    assert encode([23, 24, 25], values) == struct.pack(">hbH", -300, -5, 65000)


@given(st.integers(0, 65535), st.integers(-(2**15), 2**15 - 1))
def test_encoder_difference_inverts_counting(before, counts):
    assert encoder_difference(before, (before + counts) % 65536) == counts


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: drive_direct(right=-501, left=0), "right = -501"),
        (lambda: drive_direct(right=0, left=501), "left = 501"),
        (lambda: stream([7, 8, 59]), r"ids\[2\] = 59"),
        (lambda: stream([]), "at least one"),
        (lambda: stream([100, 100, 101]), "at most 172"),
        (lambda: StreamParser([3, 102]), r"ids\[1\] = 102"),
        (lambda: encode([7], {"wall": 1}), "'contact'"),
        (lambda: encode([7], {"contact": 16}), "contact = 16"),
        (lambda: encode([23], {"current": 40000}), "current = 40000"),
    ],
)
def test_values_that_the_interface_cannot_carry_are_refused(call, named):
    with pytest.raises(ValueError, match=named):
        call()


SPEEDS = st.integers(-500, 500)
OPCODES = {7, *range(128, 174)}


def right_left(right, left):
    return drive_direct(right=right, left=left)


def query(ids):
    return bytes([149, len(ids), *ids])


commands = st.one_of(
    st.tuples(st.just(right_left), SPEEDS, SPEEDS),
    st.tuples(st.just(stream), lists_of_ids),
    st.tuples(st.just(query), lists_of_ids),
    st.tuples(
        st.just(bytes),
        st.sampled_from([RESET, START, SAFE, STOP, b"\x8c\0\2<\x08>\x08", b"\x8e\x64", b"\x96\0"]),
    ),
)


@given(st.lists(commands), st.integers(1, 7))
def test_commands_are_parsed_in_pieces_of_any_size(calls, piece):
    sent = [command(*arguments) for command, *arguments in calls]
    data = b"".join(sent)
    parser = CommandParser()
    heard = [c for i in range(0, len(data), piece) for c in parser.feed(data[i : i + piece])]
    assert [bytes([c.opcode]) + c.data for c in heard] == sent


def test_a_truncated_command_takes_the_bytes_of_the_next():
    parser = CommandParser()
    assert parser.feed(bytes([145, 0, 100])) == []
    assert parser.feed(bytes([128, 173])) == [Command(145, bytes([0, 100, 128, 173]))]


@given(st.binary())
def test_commands_of_any_bytes_raise_no_error(data):
    CommandParser().feed(data)


def test_noise_before_a_frame_is_skipped():
    parser = StreamParser([29, 13])
    banner = b"\r\nr3_robot/tags/release-3.5.2\r\n"
    frame = bytes([19, 5, 29, 2, 25, 13, 0, 163])
    assert len(parser.feed(banner + frame[:5])) == 0
    assert len(parser.feed(frame[5:])) == 1
    assert parser.skipped == len(banner)


def test_a_frame_with_values_out_of_range_is_skipped():
    body = bytes([7, 16])
    frame = bytes([19, 2]) + body
    assert StreamParser([7]).feed(frame + bytes([-sum(frame) % 256])) == []


def streams_of(ids):
    return st.tuples(st.just(ids), st.lists(values_of(ids), max_size=4))


@given(st.just(STREAM).flatmap(streams_of) | lists_of_ids.flatmap(streams_of), st.integers(1, 40))
def test_a_stream_is_parsed_in_pieces_of_any_size(ids_and_values, piece):
    ids, values = ids_and_values
    data = b"".join(stream_frame(ids, v) for v in values)
    parser = StreamParser(ids)
    heard = [f for i in range(0, len(data), piece) for f in parser.feed(data[i : i + piece])]
    assert heard == values
    assert parser.skipped == 0


def damaged(frame, kind, place, byte):
    """Change, lose or double one byte of a frame."""
    place %= len(frame)
    if kind == "changed":
        return frame[:place] + bytes([byte]) + frame[place + 1 :]
    return frame[:place] + (frame[place : place + 1] * 2 * (kind == "doubled")) + frame[place + 1 :]


damages = st.tuples(
    st.sampled_from(["changed", "lost", "doubled"]),
    st.integers(0, 200),
    st.integers(0, 255) | st.just(HEADER),
)


@given(st.lists(st.tuples(damages, *[values_of(STREAM)] * 3), min_size=1, max_size=4))
def test_one_damaged_byte_in_three_frames_gives_no_wrong_values(rows):
    data = b""
    true = []
    for damage, *frames in rows:
        true += frames
        first, *rest = (stream_frame(STREAM, values) for values in frames)
        data += damaged(first, *damage) + b"".join(rest)
    heard = StreamParser(STREAM).feed(data)
    remaining = iter(true)
    assert all(frame in remaining for frame in heard), "a frame that was not sent, or out of order"
    assert len(true) - len(heard) <= 2 * len(rows)


@given(st.lists(st.tuples(damages, values_of(STREAM)), max_size=6), st.binary(max_size=50))
def test_damaged_bytes_raise_no_error(rows, noise):
    data = b"".join(damaged(stream_frame(STREAM, values), *damage) for damage, values in rows)
    StreamParser(STREAM).feed(noise + data + noise)


def sent(right: int, left: int) -> tuple[int, int]:
    return wheel_speeds(right=right / 1000, left=left / 1000)


@given(right=SPEEDS, left=SPEEDS, lost=st.integers(0, 4))
def test_a_pair_with_a_lost_byte_is_no_other_command(right, left, lost):
    right, left = sent(right, left)
    command = drive_direct(right=right, left=left)
    damaged = CommandParser().feed(command[:lost] + command[lost + 1 :])
    assert {parsed.opcode for parsed in damaged} <= {145}


@pytest.mark.parametrize(("side", "lost"), [(1, 46), (-1, 92)], ids=["straight", "turn"])
def test_a_motion_keeps_its_kind_at_every_speed(side, lost):
    for speed in range(-500, 501):
        right, left = sent(speed, side * speed)
        assert right == side * left
        assert right * speed >= 0
        assert abs(right) <= abs(speed) <= abs(right) + lost
        # A speed without an opcode is not changed.
        if not OPCODES & set(drive_direct(right=speed, left=side * speed)[1:]):
            assert right == speed


@given(right=SPEEDS, left=SPEEDS)
def test_a_pair_that_is_replaced_is_slower_on_the_same_arc(right, left):
    pair, wanted = sent(right, left), (right, left)
    assert not OPCODES & set(drive_direct(right=pair[0], left=pair[1])[1:])
    fast = max((0, 1), key=lambda wheel: abs(wanted[wheel]))
    slow = 1 - fast
    assert abs(pair[fast]) <= abs(wanted[fast])
    assert pair[fast] * wanted[fast] >= 0
    # The error of the slower wheel is at most half a mm/s.
    assert abs(pair[slow] * wanted[fast] - wanted[slow] * pair[fast]) <= abs(wanted[fast]) / 2


@pytest.mark.parametrize(("right", "left"), [(0.501, 0.0), (0.0, float("nan"))])
def test_a_speed_out_of_range_is_refused(right, left):
    with pytest.raises(ValueError, match=r"= (0.501|nan): expected -0.5 to 0.5 m/s"):
        wheel_speeds(right=right, left=left)
