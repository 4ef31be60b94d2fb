"""MCAP files to read, written with the mcap library."""

import json

from mavlink_streams import NOW
from mcap.reader import make_reader
from mcap.writer import Writer

from mavdem.ingest import read_log
from mavdem.ingest.mcap.records import write_mcap
from mavdem.ingest.tlog import tlog_stream


class Recorder:
    """Writes messages by topic; every channel is registered when first used."""

    def __init__(self, path, **options):
        self.path = path
        self._file = path.open("wb")
        self._writer = Writer(self._file, **options)
        self._writer.start()
        self._channels = {}
        self._time = NOW * 1000

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._writer.finish()
        self._file.close()

    def log(self):
        """What is read of the file, which is finished by that."""
        self.__exit__()
        return read_log(self.path)

    def vehicle(self):
        """The only one of the file, which is finished by that."""
        (vehicle,) = self.log().vehicles
        return vehicle

    def write(
        self,
        topic,
        data,
        encoding="json",
        schema=True,
        time=None,
    ):
        """Writes a message to a topic, 10 ms after the one before unless its time, ns, is given."""
        if topic not in self._channels:
            number = (
                self._writer.register_schema(topic.replace("/", "."), "jsonschema", b"{}")
                if schema
                else 0
            )
            self._channels[topic] = self._writer.register_channel(topic, encoding, number)
        self._time += 10_000_000
        time = self._time if time is None else time
        self._writer.add_message(self._channels[topic], log_time=time, data=data, publish_time=time)

    def blueos(
        self,
        name,
        fields,
        sequence=0,
        system=1,
    ):
        """A message as BlueOS records it; ``fields`` as JSON text where they are to be written just so."""
        inner = fields if isinstance(fields, str) else json.dumps(fields)[1:-1]
        header = (
            f'{{"system_id":{system},"component_id":1,"sequence":{sequence % 256},"message_id":0}}'
        )
        body = f'{{"header":{header},"message":{{"type":"{name}",{inner}}}}}'.encode()
        self.write(f"mavlink/{system}/1/{name}", body)
        self.write("mavlink/out", body)

    def flight(self, times, **how):
        """A heartbeat, and ATTITUDE and SERVO_OUTPUT_RAW at boot clock times, s."""
        self.blueos("HEARTBEAT", HEARTBEAT, 0, **how)
        for row, time in enumerate(times):
            boot_us = round(time * 1e6) % 2**32
            self.blueos(
                "ATTITUDE",
                {"time_boot_ms": round(time * 1e3), "roll": 0.1, "yaw": row},
                2 * row + 1,
                **how,
            )
            self.blueos(
                "SERVO_OUTPUT_RAW", {"time_usec": boot_us, "servo1_raw": 1500}, 2 * row + 2, **how
            )


HEARTBEAT = (
    '"custom_mode":5,"mavtype":{"type":"MAV_TYPE_QUADROTOR"},"autopilot":{"type":"MAV_AUTOPILOT_ARDUPILOTMEGA"},'
    '"base_mode":{"bits":209},"system_status":{"type":"MAV_STATE_ACTIVE"},"mavlink_version":3'
)


def spoil(path, chance):
    """In one place or many of a file, bytes are lost, changed or added."""
    content = bytearray(path.read_bytes())
    for _ in range(chance.choice([1, 3, 30, 300])):
        place = chance.randrange(len(content))
        content[place : place + chance.randrange(3)] = chance.randbytes(chance.randrange(4))
    path.write_bytes(content)


def converted(log, folder):
    """The recorded stream of a telemetry log as this project writes it."""
    path = folder / f"{log.stem}.mcap"
    with path.open("wb") as file:
        write_mcap(file, tlog_stream(log))
    return path


def json_only(mcap, folder):
    """The same file without the frames, everything repeated on ``mavlink/out`` as BlueOS does."""
    path = folder / f"{mcap.stem}_json.mcap"
    with mcap.open("rb") as file, Recorder(path) as recorder:
        for schema, channel, message in make_reader(file).iter_messages(log_time_order=False):
            if schema is not None:
                recorder.write(channel.topic, message.data, time=message.log_time)
                recorder.write("mavlink/out", message.data, time=message.log_time)
    return path
