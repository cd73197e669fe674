"""A host that is not ours before the emulated segment: SOEM, through the package pysoem.

Scans, reads objects, leads all devices to OP, exchanges and compares the working counter. It exits with 0 when
everything was right. Usage: host.py INTERFACE [CYCLES] [PERIOD_US]
"""

import struct
import sys
import time

import pysoem

EXPECTED = ["EK1100", "EL4134", "EL5101", "EL1008", "EL2008", "TK402"]


def main():
    interface = sys.argv[1]
    cycles = int(sys.argv[2]) if len(sys.argv) > 2 else 1000
    period = float(sys.argv[3]) * 1e-6 if len(sys.argv) > 3 else 1e-3
    host = pysoem.Master()
    host.open(interface)
    found = host.config_init()
    names = [one.name for one in host.slaves]
    assert found == len(EXPECTED) and all(n.startswith(e) for n, e in zip(names, EXPECTED)), names
    analog, encoder, _, lines, drive = host.slaves[1:]
    assert analog.sdo_read(0x1008, 0) == b"EL4134"
    assert struct.unpack("<I", drive.sdo_read(0x6076, 0))[0] == 1270
    drive.sdo_write(0x605A, 0, struct.pack("<h", 6))
    assert drive.sdo_read(0x605A, 0) == struct.pack("<h", 6)
    try:
        drive.sdo_read(0x5555, 0)
        raise AssertionError("an object that does not exist was read")
    except pysoem.SdoError as error:
        assert error.abort_code == 0x06020000, hex(error.abort_code)
    size = host.config_map()
    has_clocks = host.config_dc()
    assert host.state_check(pysoem.SAFEOP_STATE, 1_000_000) == pysoem.SAFEOP_STATE
    host.send_processdata()
    host.receive_processdata(20_000)
    host.state = pysoem.OP_STATE
    host.write_state()
    for _ in range(200):
        host.send_processdata()
        host.receive_processdata(20_000)
        if host.state_check(pysoem.OP_STATE, 10_000) == pysoem.OP_STATE:
            break
    assert host.state_check(pysoem.OP_STATE, 100_000) == pysoem.OP_STATE, "OP was not reached"
    wrong, silent, word, first, times = 0, 0, 6, None, []
    due = time.perf_counter()
    for _ in range(cycles):
        analog.output = struct.pack("<4h", 16384, -16384, 0, 0)
        lines.output = bytes([0x05])
        status = struct.unpack_from("<H", drive.input)[0]
        word = {0x40: 6, 0x21: 7, 0x23: 15, 0x27: 15}.get(status & 0x6F, 6)
        drive.output = struct.pack("<HiihB", word, 0, 0, 100, 10)
        begin = time.perf_counter()
        host.send_processdata()
        counter = host.receive_processdata(20_000)
        times.append(time.perf_counter() - begin)
        silent += counter <= 0
        wrong += counter != host.expected_wkc
        count = struct.unpack_from("<H", encoder.input, 1)[0]
        first = count if first is None else first
        due += period
        time.sleep(max(0.0, due - time.perf_counter()))
    times.sort()
    micros = [1e6 * times[int(part * (len(times) - 1))] for part in (0.5, 0.99, 1.0)]
    torque = struct.unpack_from("<h", drive.input, 10)[0]
    print(
        f"{found} devices, {size} bytes, clocks {has_clocks}, expected counter {host.expected_wkc}: "
        f"{cycles} cycles, wrong counter {wrong}, of them no answer {silent}; exchange us median "
        f"{micros[0]:.0f} p99 {micros[1]:.0f} max {micros[2]:.0f}; encoder moved {(count - first) & 0xFFFF}, "
        f"drive status {status:#06x} torque {torque}"
    )
    host.state = pysoem.INIT_STATE
    host.write_state()
    host.close()
    # A shared machine may miss a frame's time; a counter that is wrong otherwise is an error.
    assert wrong == silent and silent <= cycles // 100, (wrong, silent)
    assert status & 0x6F == 0x27 and torque == 100 and (count - first) & 0xFFFF > 0


main()
