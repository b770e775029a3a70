"""Light that a clear, round fibre scatters, such as a filament of nylon.

The model is that of Chiang, Bitterli, Tappan, Burley: A practical and controllable hair and fur model for production
path tracing, Computer Graphics Forum 35(2), 2016, after Marschner et al., SIGGRAPH 2003, and d'Eon et al., EGSR 2011:
light is reflected (R), passes through (TT), is reflected once inside (TRT), or leaves after more reflections. Each of
these lobes p is

    S_p(w_i, w_o) cos(theta_i) = M_p(theta_i, theta_o) A_p N_p(phi),

theta the angles of light and view to the fibre's normal plane, phi their azimuths' difference. M_p spreads light along
the fibre about theta_i = -theta_o, N_p about the azimuth of the ray that enters off the fibre's axis by h radii, and
A_p is the energy of that ray, by Fresnel's law and absorption. Without absorption the energies add up to 1, and so does
all scattered light. The fibre's surface has no scales, so that lobes are not tilted.
"""

from __future__ import annotations

import math

import numpy as np

from nuno_geometry.poses import Vector
from nuno_kernels import kernel
from nuno_kernels.lanes import cross, dot
from nuno_schemas.fabric import Float

NYLON = 1.53
"""Refractive index of nylon 6.6: about 1.52 across its filaments, 1.58 along them (Morton & Hearle, Physical Properties
of Textile Fibres)."""
NARROW = 0.1
"""variance below which M_p is computed by logarithms: its Bessel function overflows"""


def find_lobes(roughness: float) -> Float:
    """Return the variances of M for R, TT, TRT and the scale of N (4,) of a roughness from 0 to 1 (equations 7, 8)."""
    b = roughness
    variance = (0.726 * b + 0.812 * b**2 + 3.7 * b**20) ** 2
    scale = math.sqrt(math.pi / 8.0) * (0.265 * b + 1.194 * b**2 + 5.372 * b**22)
    return np.array([variance, 0.25 * variance, 4.0 * variance, scale])


def find_absorption(colour: Float, roughness: float) -> Float:
    """Return the absorption per radius of fibres that have a colour (..., 3) in bulk, linear (equation 9)."""
    b = roughness
    depth = 5.969 - 0.215 * b + 2.532 * b**2 - 10.73 * b**3 + 5.574 * b**4 + 0.245 * b**5
    return np.asarray((np.log(np.clip(colour, 1e-4, 1.0)) / depth) ** 2)


def find_energies(absorption: Float) -> tuple[Float, Float]:
    """Return the shares of light (..., 3) that pass through fibres of an absorption (..., 3), and that are sent back:
    by TT, and by all other lobes, in the mean over a fibre's width at right angles to it.
    """
    h = (np.arange(64) + 0.5) / 64
    inside = np.sqrt(NYLON * NYLON - h * h)
    reflected = np.array([fresnel(cosine, NYLON) for cosine in np.sqrt(1.0 - h * h)])
    left = np.exp(-2.0 * np.asarray(absorption)[..., None] * inside / NYLON)
    passed = (1.0 - reflected) ** 2 * left
    back = reflected + passed * left * reflected / (1.0 - left * reflected)
    return passed.mean(axis=-1), back.mean(axis=-1)


@kernel
def bessel_log(x: float) -> float:
    """Return log I_0(x) for x >= 0: the power series, or from 12 on the asymptotic one."""
    if x > 12.0:
        return x - 0.5 * math.log(2.0 * math.pi * x) + math.log(1.0 + 1.0 / (8.0 * x) + 9.0 / (128.0 * x * x))
    total, term, k = 1.0, 1.0, 1.0
    while term > 1e-12 * total:
        term *= 0.25 * x * x / (k * k)
        total, k = total + term, k + 1.0
    return math.log(total)


@kernel
def along_fibre(sin_i: float, cos_i: float, sin_o: float, cos_o: float, v: float) -> float:
    """Return M of variance v, whose integral over theta_i is 1 with the weight cos(theta_i)."""
    log = bessel_log(cos_i * cos_o / v) - sin_i * sin_o / v
    if v <= NARROW:
        return math.exp(log - 1.0 / v - math.log(v))
    return math.exp(log) / (2.0 * v * math.sinh(1.0 / v))


@kernel
def about_fibre(turn: float, s: float) -> float:
    """Return N: a logistic of scale s cut off at half a turn, whose integral over the azimuth is 1."""
    x = abs(turn - 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)) / s
    e = math.exp(-x)
    whole = 2.0 / (1.0 + math.exp(-math.pi / s)) - 1.0
    return e / (s * (1.0 + e) ** 2 * whole)


@kernel
def fresnel(cosine: float, eta: float) -> float:
    """Return the share of unpolarised light that a surface reflects, at the cosine of its angle outside."""
    inside = math.sqrt(max(1.0 - (1.0 - cosine * cosine) / (eta * eta), 0.0))
    parallel = (eta * cosine - inside) / (eta * cosine + inside)
    across = (cosine - eta * inside) / (cosine + eta * inside)
    return 0.5 * (parallel * parallel + across * across)


@kernel
def scatter(t: Vector, n: Vector, light: Float, view: Vector, absorption: Float, lobes: Float, out: Float) -> None:
    """Write into out (3,) pi times the share of light from `light` that a fibre along t scatters toward `view`, per
    unit of solid angle and with cos(theta_i): the radiance where a white diffuse surface that faces the light has 1.

    All are unit vectors (3,), n the normal where the ray meets the fibre.
    """
    sin_i, sin_o = dot(t, light), dot(t, view)
    cos_i, cos_o = math.sqrt(max(1.0 - sin_i * sin_i, 0.0)), math.sqrt(max(1.0 - sin_o * sin_o, 1e-12))
    phi = math.atan2(dot(t, cross(view, light)), dot(light, view) - sin_i * sin_o)
    gamma = -math.atan2(dot(t, cross(view, n)), dot(n, view) - dot(n, t) * sin_o)
    h = min(max(math.sin(gamma), -1.0), 1.0)
    reflected = fresnel(cos_o * math.sqrt(1.0 - h * h), NYLON)
    cos_in = math.sqrt(1.0 - (sin_o / NYLON) ** 2)
    gamma_in = math.asin(min(max(h * cos_o / math.sqrt(NYLON * NYLON - sin_o * sin_o), -1.0), 1.0))
    shares = (
        along_fibre(sin_i, cos_i, sin_o, cos_o, lobes[0]) * about_fibre(phi + 2.0 * gamma, lobes[3]),
        along_fibre(sin_i, cos_i, sin_o, cos_o, lobes[1])
        * about_fibre(phi - 2.0 * gamma_in + 2.0 * gamma - math.pi, lobes[3]),
    )
    third = along_fibre(sin_i, cos_i, sin_o, cos_o, lobes[2])
    inner = third * about_fibre(phi - 4.0 * gamma_in + 2.0 * gamma - 2.0 * math.pi, lobes[3])
    rest = third / (2.0 * math.pi)
    for k in range(3):
        passed = math.exp(-2.0 * absorption[k] * math.cos(gamma_in) / cos_in)
        once = (1.0 - reflected) ** 2 * passed
        twice = once * passed * reflected
        more = twice * passed * reflected / (1.0 - passed * reflected)
        out[k] = math.pi * (reflected * shares[0] + once * shares[1] + twice * inner + more * rest)
