"""Which engines `nuno bench peers skirt` steps the skirt with, at which settings, and how each is given it."""

from __future__ import annotations

from nuno_bench.peers.contact.table import at, ours
from nuno_bench.peers.table import Kind, Setting

SPRINGS = (
    "Springs and hinges of the cloth, damped by 0.05 of critical; capsules push by penalty; solver and cloth contact "
    "as a scene has them."
)
SAME = (
    "The same vertices, masses, waist and drag; capsules are kinematic bodies, posed in every step; contact by springs "
    "of 1,000 N/m; single precision. "
)
EXACT = "The skirt's own springs, dampers and hinges. "


def _nuno(solver: str, given: str, *steps: str) -> Kind:
    return ours("nuno_bench.peers.skirt.ours", solver, given, *steps, posed=SPRINGS)


def _newton(made: str, settings: dict[str, Setting], posed: str) -> Kind:
    return Kind(f"newton-{made.lower()}", "newton", "nuno_bench.peers.skirt.newton", made, settings, SAME + posed)


KINDS = (
    _nuno("respa", "", "auto"),
    _nuno("symplectic_euler", "", "auto"),
    _nuno("implicit_euler", "residual: 1e-1, ", "1"),
    _newton("XPBD", at(10, 4) | at(100, 1),
            f"{EXACT}It adds up the corrections of all springs of a vertex without relaxation, which diverges unless "
            "the step is so small that compliance holds it back. Cloth meets cloth as balls at its vertices, of the "
            "thickness: edges and triangles may pass."),
    _newton("VBD", at(10, 4, "as cloth_twist"),
            f"{EXACT}Self-contact within the thickness, by triangles without a stiffness; its buffers are as in the "
            "example cloth_twist. Edges that meet are the mesh's and those of hinges."),
    _newton("Style3D", at(10, 4, "as cloth_style3d") | at(20, 10),
            "Baraff and Witkin's triangles of the fabric's warp, weft and shear instead of springs, each flat as "
            "long as its springs are; no dampers, but 0.2% of all velocities are taken away in every step; quadratic "
            "bending of their edges, of the hinges' stiffness, which a cell whose triangles have the other diagonal "
            "has on that one. Self-contact within the thickness."),
)  # fmt: skip
