"""Reads a recording with the official MCAP library and checks it. Usage: check_recording.py FILE.mcap

Needs `pip install mcap mcap-protobuf-support`. Continuous integration runs it on a recording that the
tests have made.
"""

import ctypes
import json
import sys
from collections import Counter

import touchline_messages as messages
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

KINDS = {
    "u8": ctypes.c_uint8,
    "u16": ctypes.c_uint16,
    "u32": ctypes.c_uint32,
    "u64": ctypes.c_uint64,
    "f32": ctypes.c_float,
    "f64": ctypes.c_double,
}


def structures_of(schema):
    """The structures that a recording itself describes: no knowledge of Touchline is needed."""
    known = dict(KINDS)
    for structure in schema["structures"]:
        fields = []
        for field in structure["fields"]:
            kind = known[field["type"]]
            fields.append((field["name"], kind * field["count"] if "count" in field else kind))
        made = type(structure["name"], (ctypes.Structure,), {"_fields_": fields})
        assert ctypes.sizeof(made) == structure["size"], structure["name"]
        for field in structure["fields"]:
            assert getattr(made, field["name"]).offset == field["offset"], field["name"]
        known[structure["name"]] = made
    return known


def check_frame(frame):
    """A frame as viewers see it, and our own header within."""
    header = messages.unpack(messages.FrameHeader, frame.touchline_frame_header)
    assert (frame.width, frame.height, frame.step) == (header.width, header.height, header.stride)
    assert frame.encoding.startswith("bayer_"), frame.encoding
    assert len(frame.data) >= frame.step * frame.height
    stamp = frame.timestamp.seconds * 10**9 + frame.timestamp.nanos
    assert stamp == header.t_capture_wall_ns
    return header.seq


def check_scene(scene):
    """A scene has the pitch, or robots and a ball with poses."""
    for entity in scene["entities"]:
        assert entity["frame_id"] == "field" and entity["id"]
        for kind in ("cubes", "spheres", "arrows"):
            for item in entity[kind]:
                position = item["pose"]["position"]
                assert all(abs(position[axis]) < 10 for axis in "xyz"), position
    return [entity["id"] for entity in scene["entities"]]


def main(path):
    counts, frames, worlds, ids = Counter(), [], [], set()
    described = {}
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None, "there is no summary"
        factory = DecoderFactory()
        last_ns = 0
        for schema, channel, message in reader.iter_messages():
            assert message.log_time >= last_ns, "the index is not in order"
            last_ns = message.log_time
            counts[channel.topic] += 1
            if channel.message_encoding == "protobuf":
                frames.append(check_frame(factory.decoder_for("protobuf", schema)(message.data)))
            elif channel.message_encoding == "json":
                value = json.loads(message.data)
                if channel.topic == "scene":
                    ids.update(check_scene(value))
                elif channel.topic == "setup":
                    assert "[camera]" in value["config_toml"]
            else:
                assert channel.message_encoding == schema.encoding == "touchline-memory"
                if channel.topic not in described:
                    layout = json.loads(schema.data)
                    described[channel.topic] = structures_of(layout)[layout["message"]]
                    # Same as the generated module.
                    generated = getattr(messages, layout["message"])
                    assert ctypes.sizeof(generated) == ctypes.sizeof(described[channel.topic])
                if channel.topic == "world":
                    by_file = messages.unpack(described["world"], message.data)
                    world = messages.unpack(messages.WorldFrame, message.data)
                    assert bytes(world) == bytes(by_file)
                    worlds.append((world.frame.seq, world.robot_count))
                elif channel.topic == "runs":
                    size = ctypes.sizeof(messages.RunsHeader)
                    header = messages.RunsHeader.from_buffer_copy(message.data)
                    assert len(message.data) == size + header.run_count * ctypes.sizeof(messages.Run)
    assert counts == Counter(
        {
            summary.channels[channel_id].topic: count
            for channel_id, count in summary.statistics.channel_message_counts.items()
        }
    ), (counts, summary.statistics)
    assert len(frames) > 100 and frames == sorted(set(frames)), "frames are not in order"
    assert len(worlds) > 100 and max(count for _, count in worlds) >= 2
    assert {"pitch", "ball"} <= ids and any(name.startswith("blue") for name in ids), ids
    print(f"{path}: {sum(counts.values())} messages checked: {dict(counts)}")


main(sys.argv[1])
