"""A sphere on the bonded layer, ours and the package ContactMechanics (PyPI) in turns in one process:
`taktil bench contact` runs it where the package is installed.

usage: contact_mechanics.py PATH_OF_TAKTIL
needs: pip install ContactMechanics

Both are told the penetration (that of 5 N, from our fine solution); the error is the largest
difference of a 16 x 16 image to our fine one (exact to 1e-8), over its peak. ContactMechanics has
no base stress: its pressures go through the exact base transfer function and the tactel's window
here, outside the clock. Its clock sees the solver alone, ours the solver and the image.
"""
import json
import statistics
import subprocess
import sys
import time

import numpy as np
from ContactMechanics import PeriodicFFTElasticHalfSpace
from ContactMechanics.Systems import NonSmoothContactSystem
from SurfaceTopography import Topography

RADIUS, T, NU, E, PITCH, TACTELS = 10.0, 0.8, 0.49, 27.58, 1.5875, 16
PLACE = (0.4, -0.3)
ROUNDS = 5
BOX = 8


class Taktil:
    def __init__(self, path):
        pipe = subprocess.PIPE
        self.process = subprocess.Popen([path, "calc"], stdin=pipe, stdout=pipe, text=True)

    def sphere(self, level, drive, repeat=20):
        shape = {"sphere": {"radius_mm": RADIUS, "x_mm": PLACE[0], "y_mm": PLACE[1]}}
        request = {"op": "contact_3d", "shape": shape, "t_mm": T, "nu": NU, "level": level,
                   "timing": True, "repeat": repeat, **drive}
        self.process.stdin.write(json.dumps(request) + "\n")
        self.process.stdin.flush()
        answer = json.loads(self.process.stdout.readline())
        assert answer["ok"], answer
        return np.array(answer["image"]).reshape(TACTELS, TACTELS), answer


def base_transfer(k):
    a = np.minimum(k * T, 300.0)
    m, kap, q = 2 * (1 - NU), 3 - 4 * NU, np.exp(-2 * np.minimum(k * T, 300.0))
    determinant = (a * a + m * m) * q + 0.25 * kap * (1 - q) ** 2
    return 0.5 * m * np.exp(-a) * (a * (1 - q) + m * (1 + q)) / determinant


class Package:
    """The package on n x n cells, a whole number of them in a tactel, in a periodic box of 8 tactels,
    wide enough for this layer; a wider box would cost it more."""

    def __init__(self, per_tactel, delta):
        self.n, self.side = BOX * per_tactel, BOX * PITCH
        self.per_tactel, self.delta = per_tactel, delta
        x = (np.arange(self.n) + 0.5) * self.side / self.n - self.side / 2
        u, v = np.meshgrid(x - PLACE[0], x - PLACE[1], indexing="ij")
        r2 = np.minimum(u * u + v * v, 0.9 * RADIUS ** 2)
        heights = -(RADIUS - np.sqrt(RADIUS ** 2 - r2))
        n, side = (self.n, self.n), (self.side, self.side)
        self.substrate = PeriodicFFTElasticHalfSpace(n, E, side, thickness=T, poisson=NU)
        self.topography = Topography(heights, physical_sizes=side)

    def solve(self):
        system = NonSmoothContactSystem(self.substrate, self.topography)
        start = time.perf_counter()
        found = system.minimize_proxy(offset=self.delta, pentol=1e-7)
        elapsed = time.perf_counter() - start
        assert found.success, found.message
        return elapsed, np.asarray(system.force).reshape(self.n, self.n)

    def image(self, force):
        cell = self.side / self.n
        k = 2 * np.pi * np.fft.fftfreq(self.n, cell)
        kx, ky = np.meshgrid(k, k, indexing="ij")
        field = base_transfer(np.hypot(kx, ky)) * np.fft.fft2(force / cell ** 2)
        stress = -np.real(np.fft.ifft2(field))
        means = stress.reshape(BOX, self.per_tactel, BOX, self.per_tactel).mean(axis=(1, 3))
        image, edge = np.zeros((TACTELS, TACTELS)), (TACTELS - BOX) // 2
        image[edge:-edge, edge:-edge] = means.T
        return image


def main():
    ours = Taktil(sys.argv[1])
    exact, answer = ours.sphere("fine", {"force_n": 5.0}, 1)
    drive = {"penetration_mm": answer["delta_mm"]}
    peak = np.abs(exact).max()
    packages = [Package(n, answer["delta_mm"]) for n in (8, 16, 32, 64)]
    times = {}
    errors = {}
    for _ in range(ROUNDS):
        for level in ("fast", "default", "fine"):
            image, answer = ours.sphere(level, drive)
            name = f"taktil {level}"
            times.setdefault(name, []).append(answer["ns"] * 1e-6)
            errors[name] = (np.abs(image - exact).max() / peak, answer["force_n"] / 5 - 1)
        for package in packages:
            elapsed, force = package.solve()
            name = f"ContactMechanics {package.n} x {package.n}"
            times.setdefault(name, []).append(elapsed * 1e3)
            image = package.image(force)
            errors[name] = (np.abs(image - exact).max() / peak, force.sum() / 5 - 1)
    print("method | image error | force error | ms, median | ms, least")
    for name, spent in times.items():
        image, force = errors[name]
        print(f"{name} | {image:.1e} | {force:+.1e} | {statistics.median(spent):.3f} "
              f"| {min(spent):.3f}")
    for name, spent in times.items():
        if name.startswith("Contact"):
            better = [n for n in times if n.startswith("taktil") and errors[n][0] <= errors[name][0]]
            if better:
                best = min(better, key=lambda n: statistics.median(times[n]))
                ratio = statistics.median(spent) / statistics.median(times[best])
                print(f"{best} is {ratio:.0f} times faster than {name}, at no larger error")


if __name__ == "__main__":
    main()
