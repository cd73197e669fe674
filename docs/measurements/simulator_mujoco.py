"""The same arm in MuJoCo and in Taktil, in turns: microseconds a step and error after 0.5 s of fall.

usage: simulator_mujoco.py FOLDER_OF_FIXTURES [TAKTIL] [SLICES]
       (tests/fixtures/kinematics target/dist/taktil 41)
needs: pip install mujoco numpy

Without TAKTIL only MuJoCo is timed. With it both step slice by slice in one run, so that what else
the machine does falls on both; the ratio is taken slice by slice, for each of MuJoCo's methods
against our cheapest that errs no more. Stated are medians over the slices with both quartiles.

Bodies, inertias and reflected rotors are those of `mechanics::dynamics` (distal Denavit-Hartenberg
frames); no contact, no friction, no control. The reference is sim_passive.csv, exact to 1e-12 rad.
"""
import csv
import json
import subprocess
import sys
import time

import mujoco
import numpy as np

ALPHA = [90, 0, -90, 90, -90, 0]
A = [0, 0.2032, 0, 0, 0, 0]
D = [0, 0, 0.1270, 0.2032, 0, 0]
LINKS = [
    (2.0, (0.0, -0.05, 0.0), (0.012, 0.017165, 0.012)),
    (3.853, (-0.1712, 0.0028235, 0.10706), (0.0063754, 0.025698, 0.026433)),
    (1.063, (-0.0095529, -0.0066353, 0.032941), (0.0032367, 0.0042176, 0.0011)),
    (0.1816, (0.0, 0.0089412, 0.0), (8.8275e-05, 6.3754e-05, 8.8275e-05)),
    (0.07529, (0.0, 0.0, 0.0), (1.4713e-05, 1.9617e-05, 1.4713e-05)),
    (0.01993, (0.0, 0.0, 0.015059), (7.3563e-06, 7.3563e-06, 1.9617e-06)),
]
TOOL = (0.45, (0.0, 0.0, 0.115), (9.0e-04, 9.0e-04, 1.2e-04))
GEAR = [46.72, 69.9733, 42.9867, 43.5111, 39.3846, 31.7692]
ROTOR = [33e-6, 33e-6, 33e-6, 10e-6, 10e-6, 10e-6]


def inertial(body):
    mass, com, diagonal = body
    words = [" ".join(map(repr, v)) for v in (com, diagonal)]
    return f'<inertial mass="{mass}" pos="{words[0]}" diaginertia="{words[1]}"/>'


def model():
    inner = f"<body>{inertial(TOOL)}</body>"
    for i in reversed(range(6)):
        sine, cosine = {90: (1, 0), -90: (-1, 0), 0: (0, 1)}[ALPHA[i]]
        # Axis and origin of frame i-1 in frame i at angle 0.
        axis = (0, sine, cosine)
        at = (-A[i], -D[i] * sine, -D[i] * cosine)
        half = {90: (0.5**0.5, 0.5**0.5), -90: (0.5**0.5, -(0.5**0.5)), 0: (1.0, 0.0)}[ALPHA[i]]
        inner = (
            f'<body pos="{A[i]} 0 {D[i]}" quat="{half[0]!r} {half[1]!r} 0 0">{inertial(LINKS[i])}'
            f'<joint type="hinge" axis="{axis[0]} {axis[1]} {axis[2]}" '
            f'pos="{at[0]} {at[1]} {at[2]}" armature="{ROTOR[i] * GEAR[i] ** 2!r}"/>{inner}</body>'
        )
    return (
        '<mujoco><option gravity="0 0 -9.81"><flag contact="disable"/></option>'
        f"<worldbody>{inner}</worldbody></mujoco>"
    )


class Ours:
    """Taktil's world of the arm alone, asked over a pipe; the time is that of its steps."""

    def __init__(self, program, start, span):
        command = [program, "bench", "sim", "--serve"]
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True)
        self.rest = " ".join(map(repr, map(float, [span, *start])))

    def fall(self, name, step):
        print(name.lower(), step * 1e6, self.rest, file=self.process.stdin, flush=True)
        answer = json.loads(self.process.stdout.readline())
        return 1e-9 * answer["ns"], np.array(answer["q_rad"])

    def end(self):
        self.process.stdin.close()
        self.process.wait()


class Theirs:
    def __init__(self, start, span):
        self.start, self.span = start, span
        self.model = mujoco.MjModel.from_xml_string(model())
        self.data = mujoco.MjData(self.model)

    def fall(self, name, step):
        self.model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{name}")
        self.model.opt.timestep = step
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = self.start[1:7], self.start[7:13]
        begin = time.perf_counter()
        mujoco.mj_step(self.model, self.data, round(self.span / step))
        return time.perf_counter() - begin, self.data.qpos.copy()


THEIRS = [(name, step) for name in ("EULER", "IMPLICITFAST", "RK4") for step in (2.5e-3, 1e-3, 2.5e-4)]
OURS = [("rk4", step) for step in (2.5e-3, 1.25e-3, 1e-3, 2.5e-4)]
OURS += [("implicit", 2.5e-3), ("implicit", 1.25e-3)]


def spread(values):
    """Median of some values, and the quartiles about it."""
    low, middle, high = np.quantile(values, [0.25, 0.5, 0.75])
    return f"{middle:.2f} ({low:.2f} to {high:.2f})"


def main(folder, program=None, slices="41"):
    with open(f"{folder}/sim_passive.csv", encoding="ascii") as file:
        rows = [[float(cell) for cell in row] for row in list(csv.reader(file))[1:]]
    start, end = np.array(rows[0]), np.array(rows[-1])
    span = end[0] - start[0]
    arms = {"MuJoCo": (Theirs(start, span), THEIRS)}
    if program:
        arms["Taktil"] = (Ours(program, start[1:7], span), OURS)
    times, errors = {}, {}
    for _ in range(int(slices)):
        for who, (arm, methods) in arms.items():
            for name, step in methods:
                seconds, q = arm.fall(name, step)
                times.setdefault((who, name, step), []).append(seconds)
                errors[who, name, step] = np.abs(q - end[1:7]).max()
    print("| who | integrator | step, us | error, rad | us a step | ms a simulated second |")
    print("|---|---|---|---|---|---|")
    for (who, name, step), seconds in times.items():
        second = np.array(seconds) / span
        error = errors[who, name, step]
        print(
            f"| {who} | {name} | {step * 1e6:.0f} | {error:.1e} "
            f"| {spread(second * step * 1e6)} | {spread(second * 1e3)} |"
        )
    if not program:
        return
    arms["Taktil"][0].end()
    print("\n| MuJoCo | its error, rad | Taktil, no worse | its error, rad | times as fast |")
    print("|---|---|---|---|---|")
    for key in [key for key in times if key[0] == "MuJoCo"]:
        # Errors that agree in two digits are equal: both are those of the same method.
        fit = [o for o in times if o[0] == "Taktil" and errors[o] <= 1.01 * errors[key]]
        if not fit:
            print(f"| {key[1]} {key[2] * 1e6:.0f} us | {errors[key]:.1e} | none | | |")
            continue
        best = min(fit, key=lambda o: np.median(times[o]))
        ratio = spread(np.array(times[key]) / np.array(times[best]))
        print(
            f"| {key[1]} {key[2] * 1e6:.0f} us | {errors[key]:.1e} "
            f"| {best[1]} {best[2] * 1e6:.0f} us | {errors[best]:.1e} | {ratio} |"
        )


main(*sys.argv[1:])
