"""ROS bags and MCAP files, written by rosbags and mcap: fields of topics, stamps, and topics of other stamps."""

import json
import sqlite3
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from smajax.errors import InputError
from smajax.recordings.column_mapping import ChannelMap
from smajax.recordings.read import read_recording
from smajax.recordings.recording import Recording

START = 1_700_000_000_000_000_000
STAMPS = tuple(START + k * 20_000_000 for k in range(5))
LATE = tuple(START + 10_000_000 + k * 20_000_000 for k in range(4))
DELAY = 3_000_000
CURRENT = (0.0, 0.5, 1.0, 1.5, 2.0)
FORCE = (0.0, 5.0, 10.0, 15.0)
MAPPING = {"current": ChannelMap("/drive.current", "A"), "force": ChannelMap("/cell.force.z", "N")}
ONE = {"current": MAPPING["current"]}

Messages = list[tuple[str, int, dict[str, Any]]]


def drive(stamps: Sequence[int] = STAMPS) -> Messages:
    return [("/drive", t, {"current": c, "mode": "on", "ok": True}) for t, c in zip(stamps, CURRENT, strict=False)]


def cell(stamps: Sequence[int] = LATE) -> Messages:
    return [("/cell", t, {"force": {"x": 0.0, "z": f}}) for t, f in zip(stamps, FORCE, strict=False)]


def stamped(messages: Messages) -> Messages:
    """Messages that were recorded 3 ms after their stamps."""
    return [
        (topic, t + DELAY, {"header": {"stamp": {"sec": t // 10**9, "nsec": t % 10**9}}, **content})
        for topic, t, content in messages
    ]


def write_mcap(messages: Messages, encoding: str = "json") -> None:
    with open("bench.mcap", "wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("bench", "jsonschema", b'{"type": "object"}')
        channels = {t: writer.register_channel(t, encoding, schema) for t in dict.fromkeys(t for t, _, _ in messages)}
        for topic, time, content in sorted(messages, key=lambda message: message[1]):
            writer.add_message(channels[topic], time, json.dumps(content).encode(), time)
        writer.finish()


@pytest.fixture
def read(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def call(messages: Messages, mapping: dict[str, ChannelMap] = MAPPING, **options: Any) -> Recording:
        write_mcap(messages)
        return read_recording("bench.mcap", mapping=mapping, **options)

    return call


def test_the_fields_of_a_topic_are_columns_with_the_times_of_recording(read):
    recording = read([*drive(), *cell()], ONE)
    np.testing.assert_allclose(recording.time, np.arange(5) * 0.02, rtol=1e-12)
    assert recording.channels["current"].tolist() == list(CURRENT)
    assert recording.notes == (
        "time is when messages were recorded, since those of /drive have no stamp",
        "3 fields that are not mapped to channels were left out: /drive.ok, /cell.force.x, /cell.force.z",
    )


def test_the_stamps_of_messages_are_the_time(read):
    messages = stamped(drive())
    messages[2] = (messages[2][0], messages[2][1] + 9_000_000, messages[2][2])
    recording = read(messages, ONE)
    np.testing.assert_allclose(recording.time, np.arange(5) * 0.02, rtol=1e-12)
    assert recording.notes[0] == "time is the stamp in the messages"


def test_topics_with_the_same_stamps_are_joined(read):
    recording = read([*drive(STAMPS[:4]), *cell(STAMPS[:4])])
    assert recording.channels["force"].tolist() == list(FORCE) and len(recording) == 4


def test_other_topics_are_held_or_interpolated_on_request(read):
    held = read([*drive(), *cell()], clock_topic="/drive", topic_interpolation="hold")
    np.testing.assert_allclose(held.time, np.arange(4) * 0.02, rtol=1e-12)
    assert held.channels["current"].tolist() == list(CURRENT[1:]) and held.channels["force"].tolist() == list(FORCE)
    assert "1 of 5 messages of /drive were left out, since another topic has none before or after them" in held.notes
    assert "topic /cell (4 messages) was held at the stamps of /drive" in held.notes
    linear = read([*drive(), *cell()], clock_topic="/drive", topic_interpolation="linear")
    np.testing.assert_allclose(linear.channels["force"], [2.5, 7.5, 12.5], rtol=1e-12)
    assert linear.channels["current"].tolist() == list(CURRENT[1:4])


def test_a_topic_without_a_channel_can_be_the_clock(read):
    recording = read([*drive(), *cell()], ONE, clock_topic="/cell", topic_interpolation="hold")
    assert recording.channels["current"].tolist() == list(CURRENT[:4])


REFUSED: dict[str, tuple[Messages, dict[str, Any], str]] = {
    "other stamps": ([*drive(), *cell()], {}, 'bench.mcap: columns are of topics /drive (5 messages) and /cell (4 messages) with different stamps: set clock_topic = "/drive" and topic_interpolation = "hold" or "linear"'),
    "no clock": ([*drive(), *cell()], {"topic_interpolation": "hold"}, 'topic_interpolation needs the topic whose messages are the rows: name it, as in clock_topic = "/drive"'),
    "misspelt clock": ([*drive(), *cell()], {"clock_topic": "/drvie"}, "there is no topic '/drvie' (did you mean '/drive'?): it has /drive, /cell"),
    "misspelt interpolation": ([*drive()], {"topic_interpolation": "holds"}, "topic_interpolation = \"holds\" is not known (did you mean 'hold'?)"),
    "nothing mapped": (drive(), {"mapping": {}}, 'no field is mapped to a channel: it has /drive.current, /drive.ok: map one to a channel, as in force = {column = "/drive.current", unit = "N"}'),
    "missing key": ([*drive()[:4], ("/drive", STAMPS[4], {"mode": "off"})], {"mapping": ONE}, "message 5 of topic /drive, column '/drive.current': the message has no finite number there"),
    "apart": ([*drive(), *cell([t + 10**9 for t in LATE])], {"clock_topic": "/drive", "topic_interpolation": "hold"}, "no message of /drive is between those of the other topics"),
    "clock twice": (drive(), {"mapping": ONE, "sample_period": "20 ms"}, "there is a time column, and sample_period = 20 ms: remove sample_period"),
}  # fmt: skip


@pytest.mark.parametrize("fault", REFUSED)
def test_what_does_not_fit_is_refused_with_the_option(read, fault):
    messages, options, sentence = REFUSED[fault]
    with pytest.raises(InputError) as refusal:
        read(messages, **options)
    assert str(refusal.value).startswith("bench.mcap: ") and sentence in str(refusal.value)


def test_other_files_are_refused(read):
    Path("bench.mcap").write_bytes(b"time,current")
    with pytest.raises(InputError, match=r"^bench.mcap: the file is not readable as MCAP \(.*\): recover it"):
        read_recording("bench.mcap")
    write_mcap(drive(), encoding="protobuf")
    with pytest.raises(
        InputError, match=r"^bench.mcap: no topic has messages in JSON or ROS \(it has /drive \(protobuf\)\)"
    ):
        read_recording("bench.mcap")
    for name in ("bench.bag", "bench.db3"):
        Path(name).write_bytes(b"#ROSBAG V2.0\nnothing")
        with pytest.raises(InputError, match=rf"^{name}: the file is not readable as a ROS bag \(.*\): recover it"):
            read_recording(name)


def ros_messages(store: Any, message_type: str) -> list[Any]:
    """Messages of a joint state: position and effort of two joints."""
    header, time = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    more = {"seq": 0} if "seq" in header.__dataclass_fields__ else {}
    return [
        store.types[message_type](
            header=header(stamp=time(sec=t // 10**9, nanosec=t % 10**9), frame_id="", **more),
            name=["a", "b"],
            position=np.array([0.0, 0.1 * k]),
            velocity=np.array([]),
            effort=np.array([0.0, CURRENT[k]]),
        )
        for k, t in enumerate(STAMPS)
    ]


JOINTS = {"angle": ChannelMap("/joints.position.1", "rad"), "torque": ChannelMap("/joints.effort.1", "N m")}


def write_ros(name: str) -> Path:
    """Writes joint states to a bag of ROS 1, or to one of ROS 2 in SQLite or MCAP."""
    is_first = name.endswith(".bag")
    store = get_typestore(Stores.ROS1_NOETIC if is_first else Stores.ROS2_HUMBLE)
    kind = "sensor_msgs/msg/JointState"
    if is_first:
        writer: Any = Writer1(name)
    else:
        from rosbags.rosbag2 import StoragePlugin

        writer = Writer2(
            "folder", version=9, storage_plugin=StoragePlugin.MCAP if name.endswith("mcap") else StoragePlugin.SQLITE3
        )
    with writer:
        connection = writer.add_connection("/joints", kind, typestore=store)
        for message, time in zip(ros_messages(store, kind), STAMPS, strict=True):
            data = store.serialize_ros1(message, kind) if is_first else store.serialize_cdr(message, kind)
            writer.write(connection, time + DELAY, data)
    return Path(name) if is_first else next(Path("folder").glob(f"*{Path(name).suffix}"))


@pytest.mark.parametrize("name", ["bench.bag", "bench.db3", "bench.mcap"])
def test_messages_of_ros_are_read(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    recording = read_recording(write_ros(name), mapping=JOINTS)
    np.testing.assert_allclose(recording.time, np.arange(5) * 0.02, rtol=1e-12)
    np.testing.assert_allclose(recording.channels["angle"], 0.1 * np.arange(5), rtol=1e-12)
    assert recording.channels["torque"].tolist() == list(CURRENT)
    assert recording.notes[0] == "time is the stamp in the messages"


@pytest.mark.parametrize(("name", "package"), [("bench.mcap", "mcap"), ("bench.bag", "rosbags")])
def test_a_missing_package_is_named(tmp_path, monkeypatch, name, package):
    monkeypatch.chdir(tmp_path)
    Path(name).write_bytes(b"anything")
    for module in [*sys.modules]:
        if module.split(".")[0] == package:
            monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(
        InputError, match=rf'need {package}: run pip install "smajax\[ros\]", or export the topics as CSV'
    ):
        read_recording(name)


def test_topics_of_types_that_a_bag_does_not_define_are_left_out(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = write_ros("bench.db3")
    database = sqlite3.connect(path)
    with database:
        database.execute(
            "insert into topics select id + 1, '/own', 'bench_msgs/msg/Own', serialization_format, offered_qos_profiles, type_description_hash from topics"
        )
        database.execute("insert into messages select id + 100, topic_id + 1, timestamp, data from messages")
    database.close()
    notes = read_recording(path, mapping=JOINTS).notes
    assert notes[0] == "topic /own was left out: its messages are in bench_msgs/msg/Own, which the bag does not define"
