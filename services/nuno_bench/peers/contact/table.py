"""Which engines `nuno bench peers contact` steps the pile with, at which settings, and how each is given it."""

from __future__ import annotations

from nuno_bench.peers.contact.problem import RATE
from nuno_bench.peers.table import Kind, Setting

SPRINGS = "Springs and hinges of the cloth, damped by 0.05 of critical; solver and cloth contact as a scene has them."
SAME = "The same triangles, masses, thickness and friction; single precision; no damping but the solver's own. "


def ours(module: str, solver: str, given: str, *steps: str, posed: str) -> Kind:
    """Our `solver`, what it is given beside `dt`, and what that may be: auto, or a number of steps a frame."""
    settings: dict[str, Setting] = {}
    for step in steps:
        name, dt = (
            (f"{given}dt auto", "auto") if step == "auto" else (f"{given}{step} a frame", repr(1 / RATE / int(step)))
        )
        settings[name] = {"solver": f"plugin: {solver}, {given}dt: {dt}"}
    return Kind(f"nuno-{solver}", "", module, "Solver", settings, posed)


def _nuno(solver: str, given: str, *steps: str) -> Kind:
    return ours("nuno_bench.peers.contact.ours", solver, given, *steps, posed=SPRINGS)


def at(steps: int, iterations: int, said: str = "", **more: bool) -> dict[str, Setting]:
    name = ", ".join(filter(None, [f"{steps} steps a frame, {iterations} iterations", said]))
    return {name: {"substeps": steps, "iterations": iterations, **more}}


def _newton(made: str, settings: dict[str, Setting], posed: str) -> Kind:
    return Kind(f"newton-{made.lower()}", "newton", "nuno_bench.peers.contact.newton", made, settings, SAME + posed)


KINDS = (
    _nuno("symplectic_euler", "", "auto"),
    _nuno("implicit_euler", "residual: 1e-1, ", "1"),
    _newton("VBD", at(10, 4, "as cloth_twist") | at(10, 10, "as cloth_hanging") | at(20, 10, "as poker_cards"),
            "Neo-Hookean triangles of the cloth's Lame constants, folds on their edges; self-contact within the "
            "thickness, its stiffness and buffers as in the example cloth_twist. A frame is a graph of kernels."),
    _newton("Style3D", at(10, 4, "as cloth_style3d") | at(10, 4, "its own 6 mm thickness", own_reach=True)
            | at(20, 10),
            "Baraff and Witkin's triangles of the cloth's tension and shear, not narrowing; quadratic bending of their "
            "folds. It takes 0.2% of all velocities away in every step. Its thickness is 6 mm unless a part of the "
            "solver is changed, as it is here but for a row."),
    Kind("ipctk", "ipctk", "", "", {},
         "ipc-toolkit has no solver. It judges every engine's frames, and answers questions about ours: see there."),
)  # fmt: skip
