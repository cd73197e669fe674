"""The same arm in MuJoCo: microseconds a step and error after 0.5 s of free fall.

usage: simulator_mujoco.py FOLDER_OF_FIXTURES   (tests/fixtures/kinematics)
needs: pip install mujoco numpy

Bodies, inertias and reflected rotors are those of `mechanics::dynamics` (distal Denavit-Hartenberg
frames); no contact, no friction, no control. The reference is sim_passive.csv, exact to 1e-12 rad.
"""
import csv
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


def main(folder):
    with open(f"{folder}/sim_passive.csv", encoding="ascii") as file:
        rows = [[float(cell) for cell in row] for row in list(csv.reader(file))[1:]]
    start, end = np.array(rows[0]), np.array(rows[-1])
    fall = mujoco.MjModel.from_xml_string(model())
    data = mujoco.MjData(fall)
    print("| integrator | step, us | error, rad | us a step | ms a simulated second |")
    print("|---|---|---|---|---|")
    for name in ("EULER", "IMPLICITFAST", "RK4"):
        for step in (2.5e-3, 1e-3, 2.5e-4):
            fall.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{name}")
            fall.opt.timestep = step
            count = round((end[0] - start[0]) / step)
            best = np.inf
            for _ in range(20):
                mujoco.mj_resetData(fall, data)
                data.qpos[:], data.qvel[:] = start[1:7], start[7:13]
                begin = time.perf_counter()
                mujoco.mj_step(fall, data, count)
                best = min(best, (time.perf_counter() - begin) / count)
            error = np.abs(data.qpos - end[1:7]).max()
            print(f"| {name} | {step * 1e6:.0f} | {error:.1e} | {best * 1e6:.2f} | {best / step * 1e3:.2f} |")


main(sys.argv[1])
