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


def _engine(package: str, made: str, settings: Sequence[Setting], posed: str) -> Kind:
    return Kind(f"{package}-{made.lower()}", package, f"nuno_bench.peers.{package}", made, settings, posed)


KINDS = (
    Kind("nuno-auto", "", "nuno_bench.peers.python", "Nuno",
         [{"solver": "plugin: auto", "accuracy": accuracy} for accuracy in ("preview", "normal")],
         f"{EXACT}; solver and step as nuno takes them by itself for an accuracy."),
    _nuno("symplectic_euler", "", "auto", "240"),
    _nuno("leapfrog", "", "auto", "240"),
    _nuno("dopri5", "tolerance: 1e-6, ", "auto"),
    _nuno("tr_bdf2", "residual: 1e-2, ", "1", "2", "4"),
    _nuno("implicit_euler", "residual: 1e-2, ", "1", "4"),
    Kind("numpy", "", "nuno_bench.peers.python", "NumPy", [{"dt": 1 / 7500}, {"dt": 1 / 15000}],
         f"{EXACT}; symplectic Euler written with slices of whole arrays, no compiler."),
    Kind("scipy", "scipy", "nuno_bench.peers.python", "SciPy",
         [{"method": "RK45", "rtol": 1e-3}, {"method": "RK45", "rtol": 1e-5}, {"method": "DOP853", "rtol": 1e-4}],
         f"{EXACT}; forces by the same NumPy slices. Its implicit methods are left out: each of their "
         "matrices has 24,576 columns."),
    _engine("mujoco", "Edges", [{"dt": 1 / 7500}, {"dt": 1 / 10000}],
            f"{EXACT}: springs of equal constants are a 1D flex, whose edges have that stiffness and damping; drag is "
            "an applied force. MuJoCo integrates such edges explicitly only, so integrator=Euler."),
    _engine("mujoco", "Tendons", [{"dt": 1 / 300}, {"dt": 1 / 600}, {"dt": 1 / 1200}],
            f"{EXACT}: each spring is a tendon between two sites, drag is joint damping. integrator=discrete, the one "
            "that MuJoCo documents as implicit in stiffness, with its CG solver."),
    _engine("newton", "SemiImplicit", [{"dt": 1 / 7500}, {"dt": 1 / 10000}],
            f"{EXACT}; single precision; drag is an applied force."),
    _engine("newton", "XPBD", [{"dt": 1 / 600, "iterations": 10}, {"dt": 1 / 20000, "iterations": 1}],
            f"{EXACT}; single precision. Newton's XPBD adds up the corrections of all springs of a vertex without "
            "relaxation, which diverges unless the step is so small that compliance holds it back."),
    _engine("newton", "VBD",
            [{"dt": 1 / dt, "iterations": n} for dt, n in ((600, 10), (2400, 4), (2400, 10), (4800, 4))],
            f"{EXACT}; single precision; vertices are coloured so that no spring joins two of a colour."),
)  # fmt: skip


def label(setting: Setting) -> str:
    """As a table shows it."""
    given: Setting = setting
    if "accuracy" in setting:
        given = {"accuracy": setting["accuracy"]}
    elif "solver" in setting:
        given = dict(pair.split(": ") for pair in str(setting["solver"]).split(", ") if "plugin" not in pair)
    return ", ".join(_word(name, value) for name, value in given.items())


def _word(name: str, value: float | str) -> str:
    if name in ("method", "accuracy"):
        return f"accuracy {value}" if name == "accuracy" else str(value)
    if name == "dt" and value != "auto":
        dt = float(value)
        return f"{1e3 * dt:.3g} ms" if dt >= 0.9995e-3 else f"{1e6 * dt:.3g} us"
    amount = value if value == "auto" else f"{float(value):.0e}" if name == "rtol" else f"{float(value):g}"
    if name == "iterations":
        return f"{amount} iteration{'' if value == 1 else 's'}"
    return f"{name.replace('rtol', 'tolerance')} {amount}"
