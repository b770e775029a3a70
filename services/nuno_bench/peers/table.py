"""Which engines `nuno bench peers` steps the stiff sheet with, at which settings, and how each is given it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from nuno_bench import extras

Setting = Mapping[str, float | str]

EXACT = "The sheet's own springs, dampers, masses, drag and pins"


@dataclass(frozen=True)
class Kind:
    """One way to step the sheet.

    name      as it is shown, and as --only takes it
    package   what is imported, "" for what always is there
    module    of the class `made`, which is made as `made(sheet, **setting)`
    settings  from coarse to fine
    posed     what the engine is given, and where that is not the same material
    """

    name: str
    package: str
    module: str
    made: str
    settings: Sequence[Setting]
    posed: str

    @property
    def missing(self) -> bool:
        return bool(self.package and extras.missing([self.package]))


def _nuno(solver: str, given: str, *steps: str) -> Kind:
    """`steps` are what `dt` may be: auto, or a number of steps a frame."""
    chosen = [step if step == "auto" else repr(1 / 60 / int(step)) for step in steps]
    settings = [{"solver": f"plugin: {solver}, {given}dt: {dt}"} for dt in chosen]
    posed = f"{EXACT}; kernels without services."
    return Kind(f"nuno-{solver}", "", "nuno_bench.peers.python", "Nuno", settings, posed)


def _auto() -> Kind:
    settings = [{"solver": "plugin: auto", "accuracy": accuracy} for accuracy in ("preview", "normal")]
    posed = f"{EXACT}; solver and step as nuno takes them by itself for an accuracy."
    return Kind("nuno-auto", "", "nuno_bench.peers.python", "Nuno", settings, posed)


def _newton(made: str, settings: Sequence[Setting], posed: str) -> Kind:
    return Kind(f"newton-{made.lower()}", "newton", "nuno_bench.peers.newton", made, settings, posed)


def _mujoco(made: str, settings: Sequence[Setting], posed: str) -> Kind:
    return Kind(f"mujoco-{made.lower()}", "mujoco", "nuno_bench.peers.mujoco", made, settings, posed)


WOVEN = (
    "Newton's woven triangles, since Style3D has no springs: k + s + 4 b = 1380 N/m along both threads and s = 300 "
    "N/m in shear, what springs k, s and b of a square lattice add up to, but no contraction across (C12 = 300 N/m) "
    "and no damping. Two-apart springs resist bending only once cloth is bent, so its bending stiffness is 0."
)
KINDS = (
    _auto(),
    _nuno("symplectic_euler", "", "auto", "240"),
    _nuno("leapfrog", "", "auto", "240"),
    _nuno("dopri5", "tolerance: 1e-6, ", "auto"),
    _nuno("tr_bdf2", "residual: 1e-2, ", "1", "2", "4"),
    _nuno("implicit_euler", "residual: 1e-2, ", "1", "4"),
    Kind(
        "numpy",
        "",
        "nuno_bench.peers.python",
        "NumPy",
        [{"dt": 1 / 7500}, {"dt": 1 / 15000}],
        f"{EXACT}; symplectic Euler written with slices of whole arrays, no compiler.",
    ),
    Kind(
        "scipy",
        "scipy",
        "nuno_bench.peers.python",
        "SciPy",
        [{"method": "RK45", "rtol": 1e-3}, {"method": "RK45", "rtol": 1e-5}, {"method": "DOP853", "rtol": 1e-4}],
        f"{EXACT}; forces by the same NumPy slices. Its implicit methods are left out: each of their matrices has "
        "24,576 columns.",
    ),
    _mujoco(
        "Edges",
        [{"dt": 1 / 7500}, {"dt": 1 / 10000}],
        f"{EXACT}: springs of equal constants are a 1D flex, whose edges have that stiffness and damping; drag is an "
        "applied force. MuJoCo integrates such edges explicitly only, so integrator=Euler.",
    ),
    _mujoco(
        "Tendons",
        [{"dt": 1 / 300}, {"dt": 1 / 600}, {"dt": 1 / 1200}],
        f"{EXACT}: each spring is a tendon between two sites, drag is joint damping. integrator=discrete, the one "
        "that MuJoCo documents as implicit in stiffness, with its CG solver.",
    ),
    _mujoco(
        "Membrane",
        [{"dt": 1 / 100}, {"dt": 1 / 400}, {"dt": 1 / 1000}],
        "What MuJoCo's documentation gives for cloth: a 2D flex with elasticity and integrator=discrete. It is "
        "isotropic, so it cannot be this fabric: E t = 1315 N/m and nu = 0.22 give the springs' stiffness along the "
        "threads (1380 N/m) and their contraction across, and 1.8 times their shear stiffness. Rayleigh damping is "
        "c / k of the structural springs. Two-apart springs resist bending only once cloth is bent: elastic2d=stretch.",
    ),
    _newton(
        "SemiImplicit",
        [{"dt": 1 / 7500}, {"dt": 1 / 10000}],
        f"{EXACT}; single precision; drag is an applied force.",
    ),
    _newton(
        "XPBD",
        [{"dt": 1 / 600, "iterations": 10}, {"dt": 1 / 20000, "iterations": 1}],
        f"{EXACT}; single precision. Newton's XPBD adds up the corrections of all springs of a vertex without "
        "relaxation, which diverges unless the step is so small that compliance holds it back.",
    ),
    _newton(
        "VBD",
        [
            {"dt": 1 / 600, "iterations": 10},
            {"dt": 1 / 2400, "iterations": 4},
            {"dt": 1 / 2400, "iterations": 10},
            {"dt": 1 / 4800, "iterations": 4},
        ],
        f"{EXACT}; single precision; vertices are coloured so that no spring joins two of a colour.",
    ),
    _newton(
        "Style3D",
        [
            {"dt": 1 / 60, "iterations": 10, "linear_iterations": 10},
            {"dt": 1 / 120, "iterations": 10, "linear_iterations": 10},
            {"dt": 1 / 240, "iterations": 10, "linear_iterations": 100},
        ],
        WOVEN,
    ),
)


def label(setting: Setting) -> str:
    """As a table shows it."""
    given: Setting = setting
    if "accuracy" in setting:
        given = {"accuracy": setting["accuracy"]}
    elif "solver" in setting:
        given = dict(pair.split(": ") for pair in str(setting["solver"]).split(", ") if "plugin" not in pair)
    return ", ".join(_word(name, value) for name, value in given.items())


def _word(name: str, value: float | str) -> str:
    if name == "method":
        return str(value)
    if name == "accuracy":
        return f"accuracy {value}"
    if name == "dt" and value != "auto":
        dt = float(value)
        return f"{1e3 * dt:.3g} ms" if dt >= 0.9995e-3 else f"{1e6 * dt:.3g} us"
    amount = value if value == "auto" else f"{float(value):.0e}" if name == "rtol" else f"{float(value):g}"
    if name in ("iterations", "linear_iterations"):
        return f"{amount} {name.replace('_', ' ').removesuffix('s' if value == 1 else '?')}"
    return f"{name.replace('rtol', 'tolerance')} {amount}"
