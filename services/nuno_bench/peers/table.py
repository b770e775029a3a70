"""Which engines `nuno bench peers` steps the stiff sheet with, at which settings, and how each is given it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from nuno_bench import extras

Setting = Mapping[str, float | str]

EXACT = "The sheet's own springs, dampers, masses, drag and pins"


@dataclass(frozen=True)
class Kind:
    """One way to step what is posed.

    name      as it is shown, and as --only takes it
    package   what is imported, "" for what always is there
    module    of the class `made`, which is made as `made(posed, **setting)`
    settings  by what they are shown as, from coarse to fine
    posed     what the engine is given, and where that is not the same material
    """

    name: str
    package: str
    module: str
    made: str
    settings: Mapping[str, Setting]
    posed: str

    @property
    def missing(self) -> bool:
        return bool(self.package and extras.missing(self.package))


def _nuno(solver: str, given: str, *steps: str) -> Kind:
    """`steps` are what `dt` may be: auto, or a number of steps a frame."""
    settings: dict[str, Setting] = {}
    for step in steps:
        name, dt = ("auto", "auto") if step == "auto" else (f"{step} a frame", repr(1 / 60 / int(step)))
        settings[f"{given}dt {name}"] = {"solver": f"plugin: {solver}, {given}dt: {dt}"}
    return Kind(f"nuno-{solver}", "", "nuno_bench.peers.python", "Nuno", settings, f"{EXACT}; kernels alone.")


def _at(rate: int, **more: int) -> dict[str, Setting]:
    """So many steps a second."""
    dt = f"{1e3 / rate:.3g} ms" if rate <= 1000 else f"{1e6 / rate:.3g} us"
    return {", ".join([dt, *(f"{name} {value}" for name, value in more.items())]): {"dt": 1 / rate, **more}}


def _engine(package: str, made: str, settings: Mapping[str, Setting], posed: str) -> Kind:
    return Kind(f"{package}-{made.lower()}", package, f"nuno_bench.peers.{package}", made, settings, posed)


KINDS = (
    Kind("nuno-auto", "", "nuno_bench.peers.python", "Nuno",
         {f"accuracy {one}": {"solver": "plugin: auto", "accuracy": one} for one in ("preview", "normal")},
         f"{EXACT}; solver and step as nuno takes them by itself for an accuracy."),
    _nuno("symplectic_euler", "", "auto", "240"),
    _nuno("leapfrog", "", "auto", "240"),
    _nuno("dopri5", "tolerance: 1e-6, ", "auto"),
    _nuno("tr_bdf2", "residual: 1e-2, ", "1", "2", "4"),
    _nuno("implicit_euler", "residual: 1e-2, ", "1", "4"),
    Kind("numpy", "", "nuno_bench.peers.python", "NumPy", _at(7500) | _at(15000),
         f"{EXACT}; symplectic Euler written with slices of whole arrays, no compiler."),
    Kind("scipy", "scipy", "nuno_bench.peers.python", "SciPy",
         {f"{method}, tolerance {rtol:.0e}": {"method": method, "rtol": rtol}
          for method, rtol in (("RK45", 1e-3), ("RK45", 1e-5), ("DOP853", 1e-4))},
         f"{EXACT}; forces by the same NumPy slices. Its implicit methods are left out: each of their "
         "matrices has 24,576 columns."),
    _engine("mujoco", "Edges", _at(7500) | _at(10000),
            f"{EXACT}: springs of equal constants are a 1D flex, whose edges have that stiffness and damping; drag is "
            "an applied force. MuJoCo integrates such edges explicitly only, so integrator=Euler."),
    _engine("mujoco", "Tendons", _at(300) | _at(600) | _at(1200),
            f"{EXACT}: each spring is a tendon between two sites, drag is joint damping. integrator=discrete, the one "
            "that MuJoCo documents as implicit in stiffness, with its CG solver."),
    _engine("newton", "SemiImplicit", _at(7500) | _at(10000),
            f"{EXACT}; single precision; drag is an applied force."),
    _engine("newton", "XPBD", _at(600, iterations=10) | _at(20000, iterations=1),
            f"{EXACT}; single precision. Newton's XPBD adds up the corrections of all springs of a vertex without "
            "relaxation, which diverges unless the step is so small that compliance holds it back."),
    _engine("newton", "VBD", _at(600, iterations=10) | _at(2400, iterations=4) | _at(2400, iterations=10)
            | _at(4800, iterations=4),
            f"{EXACT}; single precision; vertices are coloured so that no spring joins two of a colour."),
)  # fmt: skip
