"""The fit of a garment as tables of text, remarks and a sentence."""

from __future__ import annotations

from nuno.python_api.fit import Fit, Girth, Seam

SEAMS = 8
"""Most seams in the text, those with the largest pull."""
UNBALANCED = 0.1
"""Sum of all forces, as a share of those of contact, above which a remark says that they do not balance."""


def tables(fit: Fit) -> list[list[list[str]]]:
    """Return tables of girths and ease, openings, strains and seams, in centimetres; without those that are empty."""
    girths = [["at", "height cm", "body cm", "cut cm", "worn cm", "ease cm"], *map(_row, fit.girths)]
    openings = [["opening", "from cm", "to cm", "cut cm", "round cm"]]
    openings += [[f"{i}", *(f"{1e2 * value:.1f}" for value in (one.low, one.high, one.cut)),
                  " + ".join(f"{1e2 * girth:.1f}" for girth in one.through) or "-"]
                 for i, one in enumerate(fit.openings, 1)]  # fmt: skip
    strains = [["strain", "median %", "95 % below", "most %"]]
    strains += [[name, *(f"{100 * value:+.1f}" for value in (one.median, one.high, one.most))]
                for name, one in fit.strains.items()]  # fmt: skip
    found = [girths, openings, strains, *([_seam_rows(fit.seams)] if fit.seams else [])]
    return [rows for rows in found if len(rows) > 1 or rows is strains]


def pressing(fit: Fit) -> list[tuple[str, str]]:
    """Return a row of the pressure on the body, if it was measured."""
    if (p := fit.pressed) is None:
        return []
    text = f"{p.mean:.0f} Pa on {1e4 * p.area:.0f} cm² of cloth, 95 % of it below {p.high:.0f} Pa"
    return [("presses", f"{text}; {p.force:.2f} N in all")]


def verdict(fit: Fit) -> str:
    """Return in a sentence whether a garment is worn as it was meant, and its ease."""
    ease = ", ".join(f"{one.name} {1e2 * one.ease:+.1f} cm" for one in fit.girths if one.ease is not None)
    doubts = "; ".join(f"{name} {text}" for name, text in remarks(fit))
    return "; ".join(filter(None, [doubts or "worn, and nowhere smaller than the body", ease and f"ease: {ease}"]))


def remarks(fit: Fit) -> list[tuple[str, str]]:
    """Return remarks on a fit, heading and text: forces that do not balance, a garment that is off or has slipped,
    openings for nothing, girths below the body's; none if it is worn as it was meant.
    """
    found = list[tuple[str, str]]()
    if fit.pressed is not None and fit.pressed.unbalanced > UNBALANCED:
        why = "it is not at rest, or its contact bears more than this solver reports"
        found.append(("unbalanced", f"by {fit.pressed.unbalanced:.0%} of these forces: {why}"))
    if fit.off:
        found.append(("worn", "not at all: it touches the body nowhere, and is not on yet, or has slid off"))
    for i, one in enumerate(fit.openings, 1):
        if one.passed:
            inner, edges = " and ".join(f"{k + 1}" for k in one.passed), ", ".join(one.edges) or "of no panel"
            several = "s" if len(one.passed) > 1 else ""
            text = f"what goes out through opening{several} {inner} goes out through opening {i} ({edges}), too"
            found.append(("slipped", f"{text}: narrow it, or hold it by an elastic"))
    numbered = enumerate(fit.openings, 1)
    empty = [f"{i} ({', '.join(one.edges) or 'of no panel'})" for i, one in numbered if not one.through]
    if empty and not fit.off:
        found.append(("empty", f"nothing of the body goes through opening {', '.join(empty)}: is it worn there?"))
    if tight := [one for one in fit.girths if one.ease is not None and one.ease < 0.0]:
        girths = ", ".join(f"by {-1e2 * (one.ease or 0.0):.1f} cm at the {one.name}" for one in tight)
        found.append(("smaller", f"than the body {girths}"))
    return found


def _seam_rows(seams: list[Seam]) -> list[list[str]]:
    """Return rows of the seams with the largest pull."""
    most = sorted(seams, key=lambda one: -one.mean)[:SEAMS]
    which = "seam" if len(most) == len(seams) else f"{len(most)} of {len(seams)} seams"
    rows = [[which, "panels", "cut cm", "pulled N/m", "most N/m"]]
    return rows + [
        [one.letters, ", ".join(one.panels), f"{1e2 * one.length:.1f}", f"{one.mean:.1f}", f"{one.most:.1f}"]
        for one in most
    ]


def _row(one: Girth) -> list[str]:
    open_ = one.share is not None and one.ease is None and one.body is not None
    without = f"open, {100 * (one.share or 0):.0f} % round" if open_ else "-"
    ease = without if one.ease is None else f"{1e2 * one.ease:+.1f}"
    cells = ["-" if value is None else f"{1e2 * value:.1f}" for value in (one.body, one.cut, one.worn)]
    return [one.name, f"{1e2 * one.height:.1f}", *cells, ease]
