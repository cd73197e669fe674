"""Reads a log with the mcap project's own Python reader: another implementation than the one that wrote it.

Every message must decode by its schema, carry a true check sum as its last field, and stand in order of time on its channel.
Refuses to know what the values mean.
"""

import sys
import zlib

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory


def main(path: str) -> int:
    counts: dict[str, int] = {}
    newest: dict[str, int] = {}
    with open(path, "rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            topic = channel.topic
            assert schema.encoding == "ros2msg", f"{topic}: schema is {schema.encoding}"
            assert decoded.crc == zlib.crc32(message.data[4:-4]), f"{topic}: check sum is wrong"
            assert message.log_time >= newest.get(topic, 0), f"{topic}: time runs backwards"
            newest[topic] = message.log_time
            counts[topic] = counts.get(topic, 0) + 1
    assert counts, "no message at all"
    for topic in sorted(counts):
        print(f"{counts[topic]:8}  {topic}")
    print(f"{sum(counts.values())} messages on {len(counts)} channels, all decoded")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
