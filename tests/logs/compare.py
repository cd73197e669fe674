"""Counts the messages of logs with programs of others, and ours in logs that those wrote.

For every shipped scene a log is made; `taktil log info` says how many messages it has. The Python package `mcap` has to see as many,
and decode each; so has Rerun's converter where it is installed, row by row. The same for the log that `taktil log export` makes, whose
protobuf messages have to decode with the schemas that the file carries. Then the log is written anew by `mcap`, in chunks with LZ4 and
with Zstandard, and `taktil log info` has to see every message. In the end the program of docs/guides/python.md is run.
"""

import json
import re
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_protobuf.decoder import DecoderFactory as Protobuf
from mcap_ros2.decoder import DecoderFactory as Ros2

SECONDS = "1.5"
# Rerun prints the rows of each chunk in this form.
ROWS = re.compile(r"with (\d[\d _,.]*) rows .*? - (/[\w/]*)")


def output(*words):
    done = subprocess.run([str(w) for w in words], capture_output=True, text=True, check=False)
    return done.returncode, done.stdout, done.stderr


def info(taktil, log):
    code, out, err = output(taktil, "log", "info", log, "--json")
    if code not in (0, 1):
        raise SystemExit(f"log info {log}: {err}")
    return json.loads(out)


def counts(log):
    """Messages of each topic, each decoded; and the wall clock of the first one (s), which is that of the first chunk, too: viewers
    believe the chunks."""
    found, first = Counter(), None
    with open(log, "rb") as file:
        reader = make_reader(file, decoder_factories=[Protobuf(), Ros2()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            found[channel.topic] += 1
            first = message.log_time if first is None else min(first, message.log_time)
            if channel.topic == "/viewer/frames" and len(decoded.transforms) < 2:
                raise SystemExit(f"{log}: a message with {len(decoded.transforms)} frames")
        attachments = [a.name for a in reader.iter_attachments()]
        begin = min(chunk.message_start_time for chunk in reader.get_summary().chunk_indexes)
        if begin != (first or 0):
            raise SystemExit(f"{log}: a chunk begins at {begin} ns, and no message before {first} ns")
    return found, (first or 0) / 1e9, attachments


def rerun_counts(rerun, log, scratch):
    out = Path(scratch) / "log.rrd"
    code, _, err = output(rerun, "mcap", "convert", log, "-o", out)
    if code:
        raise SystemExit(f"rerun mcap convert {log}: {err[-600:]}")
    _, text, _ = output(rerun, "rrd", "print", out)
    rows = Counter()
    for number, topic in ROWS.findall(text):
        # One message may become several columns of one topic in chunks of their own; the longest one counts.
        rows[topic] += int(re.sub(r"\D", "", number))
    out.unlink()
    return rows


def rewritten(log, path, compression):
    """The same messages in a file of another program."""
    with open(log, "rb") as source, open(path, "wb") as target:
        reader, writer = make_reader(source), Writer(target, compression=compression)
        writer.start(profile="ros2")
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        schemas, channels = {}, {}
        for schema, channel, message in reader.iter_messages():
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[schema.id], channel.metadata
                )
            writer.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence
            )
        writer.finish()


def guide(taktil):
    """Runs the program of the guide on the logs of two seeds; what is wrong with it."""
    text = Path("docs/guides/python.md").read_text(encoding="utf-8")
    program = text.split("```python\n", 1)[1].split("```", 1)[0]
    scene = Path("sim/scenes/roll-pin.toml").resolve()
    with tempfile.TemporaryDirectory() as folder:
        for seed, name in ((1, "a.mcap"), (2, "b.mcap")):
            words = ("run", scene, "--fast", "--for", "4", "--seed", seed, "--log", Path(folder) / name)
            code, _, err = output(taktil, *words)
            if code:
                return f"docs/guides/python.md: run: {err[-300:]}"
        done = subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, check=False, cwd=folder
        )
        print(done.stdout, end="")
        found = re.match(r"(\d+) jobs, x_c differs by ([\d.]+) columns", done.stdout)
        if done.returncode or not found or int(found[1]) < 100 or float(found[2]) <= 0:
            return f"docs/guides/python.md: {done.stdout}{done.stderr[-600:]}"
    return None


def main(taktil, rerun):
    failures, total = [], 0
    has_rerun = Path(rerun).exists()
    scenes = sorted(Path("sim/scenes").glob("*.toml"))
    with tempfile.TemporaryDirectory() as scratch:
        log, view = Path(scratch) / "log.mcap", Path(scratch) / "view.mcap"
        for scene in scenes:
            code, _, err = output(taktil, "run", scene, "--fast", "--for", SECONDS, "--log", log)
            if code == 2:
                failures.append(f"{scene}: run: {err[-300:]}")
                continue
            ours = info(taktil, log)["messages"]
            found, _, _ = counts(log)
            if sum(found.values()) != ours:
                failures.append(f"{scene}: mcap sees {sum(found.values())} of {ours}")
            code, out, err = output(taktil, "log", "export", log, "--out", view, "--json")
            if code:
                failures.append(f"{scene}: export: {err[-300:]}")
                continue
            said = json.loads(out)
            shown, first_s, attachments = counts(view)
            if sum(shown.values()) != said["messages"] + said["for_viewers"] or said["messages"] != ours:
                failures.append(f"{scene}: mcap sees {sum(shown.values())} of {said}")
            if first_s < 1.5e9 or attachments != ["robot.urdf"]:
                failures.append(f"{scene}: begins at {first_s} s of the wall clock, with {attachments}")
            again = info(taktil, view)
            if (again["messages"], again["foreign_messages"]) != (ours, said["for_viewers"]):
                failures.append(f"{scene}: we see {again['messages']} of the view's {ours}")
            for compression in (CompressionType.LZ4, CompressionType.ZSTD):
                path = Path(scratch) / "other.mcap"
                rewritten(log, path, compression)
                theirs = info(taktil, path)
                if theirs["messages"] != ours or theirs["damage"] is not None:
                    failures.append(f"{scene}: {compression.name}: we see {theirs['messages']} of {ours}, {theirs['damage']}")
                cut = path.read_bytes()[: path.stat().st_size * 2 // 3]
                path.write_bytes(cut)
                part = info(taktil, path)["messages"]
                if not 0 < part < ours and len(cut) > 2_000_000:
                    failures.append(f"{scene}: {compression.name}, cut: we see {part} of {ours}")
            if has_rerun:
                for path, wanted in ((log, found), (view, shown)):
                    rows = rerun_counts(rerun, path, scratch)
                    lacking = {t: (rows[t], n) for t, n in wanted.items() if rows[t] < n}
                    if lacking:
                        failures.append(f"{scene}: {path.name}: rerun lacks rows (seen, wanted): {lacking}")
            total += ours
            print(f"{scene.name}: {ours} messages, {said['for_viewers']} for viewers", flush=True)
    wrong = guide(taktil)
    if wrong:
        failures.append(wrong)
    if not has_rerun:
        print("SKIPPED: rerun-sdk cannot be installed here")
    for failure in failures:
        print("FAILED:", failure)
    print(f"{len(scenes)} scenes, {total} messages, {len(failures)} failures")
    return 1 if failures or not total else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2]))
