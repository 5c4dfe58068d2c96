"""The cantilever's master curve: does a simulator bend as much as a real sheet?

Romero, Ly, Rasheed, Charrondière, Lazarus, Neukirch and Bertails-Descoubes (2021), "Physical validation of simulators
in computer graphics", ACM TOG 40(4), hang strips from a clamp and compare the aspect ratio H/W of what hangs (drop over
reach) with one number, Gamma = 12 (1 - nu^2) rho g L^3 / (E h^2), weight over bending stiffness. All strips, of any
size and material, fall on one curve, which Euler's elastica gives.

    .venv/bin/python examples/cantilever.py     writes cantilever.png; 4 seconds
"""

import numpy as np
from scipy.integrate import solve_bvp
from sheets import rectangle

import voile

GAMMAS = (0.5, 2.0, 8.0, 32.0, 128.0, 512.0)
STRIPS = {  # length (m), thickness (m), density (kg/m^3)
    "paper, 20 cm": (0.2, 1e-4, 800.0),
    "rubber, 5 cm": (0.05, 5e-4, 1200.0),
}
GRAVITY = 9.81  # m/s^2


def elastica(gamma: float) -> float:
    """H/W of the heavy elastica: theta'' = -gamma (1 - s) cos(theta), theta(0) = 0, theta'(1) = 0, s from the clamp."""

    def slope(s, y):
        return np.vstack([y[1], -gamma * (1 - s) * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])])

    def ends(a, b):
        return np.array([a[0], b[1], a[2], a[3]])

    s = np.linspace(0, 1, 401) ** 2  # heavy strips bend near the clamp
    theta = np.pi / 2 * (1 - np.exp(-np.sqrt(gamma) * s)) * min(1.0, 0.2 * gamma)
    found = solve_bvp(
        slope, ends, s, np.vstack([theta, np.gradient(theta, s), s, 0 * s]), tol=1e-8, max_nodes=50000
    )
    assert found.success, found.message
    return found.y[3, -1] / found.y[2, -1]


def hung(gamma: float, length: float, thickness: float, density: float, cells: int) -> float:
    """H/W of a strip of Koiter's shell; no Poisson's effect, as in an elastica."""
    young = 12 * density * GRAVITY * length**3 / (gamma * thickness**2)
    scene = {
        "shell": {
            "mesh": rectangle((cells, 4), (length, 4 * length / cells)),
            "young": young, "poisson": 0.0, "thickness": thickness, "density": density,
        },
        "loads": {"gravity": [0, 0, -GRAVITY]},
        "fix": [{"select": {"box": [[-1, -1, -1], [1e-6, 1, 1]]}, "clamp": True}],
    }  # fmt: skip
    tip = voile.run(scene).positions
    tip = tip[tip.shape[0] - 3]  # the middle of the last row
    return -tip[2] / tip[0]


def study(cells: int = 48) -> dict[str, np.ndarray]:
    """H/W for each of GAMMAS: of the elastica, and of each of STRIPS."""
    curve = {"elastica": np.array([elastica(gamma) for gamma in GAMMAS])}
    for name, (length, thickness, density) in STRIPS.items():
        curve[name] = np.array([hung(gamma, length, thickness, density, cells) for gamma in GAMMAS])
    return curve


def draw(curve: dict[str, np.ndarray], png: str) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.subplots()
    for (name, ratio), style in zip(curve.items(), ("k-", "o", "x"), strict=True):
        axes.loglog(GAMMAS, ratio, style, label=name, markersize=9, fillstyle="none")
    axes.set(
        xlabel="Γ = 12 (1 − ν²) ρ g L³ / (E h²)", ylabel="H / W", title="Cantilevers of any size on one curve"
    )
    axes.legend(frameon=False)
    figure.savefig(png, dpi=120)


if __name__ == "__main__":
    found = study()
    print("  Gamma" + "".join(f"{name:>16}" for name in found))
    for k, gamma in enumerate(GAMMAS):
        print(f"{gamma:7g}" + "".join(f"{ratio[k]:16.4f}" for ratio in found.values()))
    draw(found, "cantilever.png")
