"""Embedded Runge-Kutta pairs: Dormand & Prince 5(4) and 8(5,3), with output between steps.

Coefficients: Hairer, Norsett & Wanner 1993, "Solving Ordinary Differential Equations I", section
II.5 and the programs DOPRI5 and DOP853; the fourth-order output of DOPRI5 is Shampine's (1986,
Math. Comp. 46, 135-150). They are written by row, zeros left out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from nuno_schemas.fabric import Float

Rows = Mapping[int, Mapping[int, float]]


@dataclass(frozen=True)
class Tableau:
    """One pair, whose last stage is at the end of the step and is the first of the next.

    order   of the result; `estimate` is that of the error estimate, which sets the step
    a       (s, s) weights; rows from `stages` on serve the output between steps alone
    c       (s,) fractions of the step
    errors  (1, stages) or (2, stages) weights of the estimate; of two, the first is the leading one
    output  theta -> (s,) weights of the state at fraction theta of the step
    """

    order: int
    estimate: int
    stages: int
    a: Float
    c: Float
    errors: Float
    output: Callable[[float], Float]

    @cached_property
    def aa(self) -> Float:
        """(s, s) weights of the positions, A A: see nuno_integrators.explicit.combine."""
        return self.a @ self.a

    @cached_property
    def position_errors(self) -> Float:
        """Weights (1 or 2, stages) of the estimate for positions."""
        used: Float = self.errors @ self.a[: self.stages, : self.stages]
        return used

    @cached_property
    def polynomial(self) -> tuple[float, ...]:
        """Coefficients of 1, z, z^2, ... of the stability polynomial: a step on y' = z y multiplies y with it.

        The stages are the sum of z^k A^k 1, and the last one is the step's end.
        """
        power, found = np.ones(self.stages), []
        for _ in range(self.stages):
            found.append(float(power[-1]))
            power = self.a[: self.stages, : self.stages] @ power
        return tuple(found)


def _table(rows: Rows, shape: tuple[int, int]) -> Float:
    table = np.zeros(shape)
    for i, row in rows.items():
        for j, value in row.items():
            table[i, j] = value
    return table


DOPRI5_A: Rows = {
    1: {0: 1 / 5},
    2: {0: 3 / 40, 1: 9 / 40},
    3: {0: 44 / 45, 1: -56 / 15, 2: 32 / 9},
    4: {0: 19372 / 6561, 1: -25360 / 2187, 2: 64448 / 6561, 3: -212 / 729},
    5: {0: 9017 / 3168, 1: -355 / 33, 2: 46732 / 5247, 3: 49 / 176, 4: -5103 / 18656},
    6: {0: 35 / 384, 2: 500 / 1113, 3: 125 / 192, 4: -2187 / 6784, 5: 11 / 84},
}
DOPRI5_E: Rows = {
    0: {0: 71 / 57600, 2: -71 / 16695, 3: 71 / 1920, 4: -17253 / 339200, 5: 22 / 525, 6: -1 / 40},
}
DOPRI5_OUTPUT: Rows = {
    0: {0: 1.0},
    1: {
        0: -8048581381 / 2820520608, 2: 131558114200 / 32700410799, 3: -1754552775 / 470086768,
        4: 127303824393 / 49829197408, 5: -282668133 / 205662961, 6: 40617522 / 29380423,
    },
    2: {
        0: 8663915743 / 2820520608, 2: -68118460800 / 10900136933, 3: 14199869525 / 1410260304,
        4: -318862633887 / 49829197408, 5: 2019193451 / 616988883, 6: -110615467 / 29380423,
    },
    3: {
        0: -12715105075 / 11282082432, 2: 87487479700 / 32700410799, 3: -10690763975 / 1880347072,
        4: 701980252875 / 199316789632, 5: -1453857185 / 822651844, 6: 69997945 / 29380423,
    },
}  # fmt: skip
"""Weights of theta, theta^2, theta^3 and theta^4."""

DOP853_A: Rows = {
    1: {0: 0.05260015195876773},
    2: {0: 0.0197250569845379, 1: 0.0591751709536137},
    3: {0: 0.02958758547680685, 2: 0.08876275643042054},
    4: {0: 0.2413651341592667, 2: -0.8845494793282861, 3: 0.924834003261792},
    5: {0: 0.037037037037037035, 3: 0.17082860872947386, 4: 0.12546768756682242},
    6: {0: 0.037109375, 3: 0.17025221101954405, 4: 0.06021653898045596, 5: -0.017578125},
    7: {
        0: 0.03709200011850479, 3: 0.17038392571223998, 4: 0.10726203044637328, 5: -0.015319437748624402,
        6: 0.008273789163814023,
    },
    8: {
        0: 0.6241109587160757, 3: -3.3608926294469414, 4: -0.868219346841726, 5: 27.59209969944671,
        6: 20.154067550477894, 7: -43.48988418106996,
    },
    9: {
        0: 0.47766253643826434, 3: -2.4881146199716677, 4: -0.590290826836843, 5: 21.230051448181193,
        6: 15.279233632882423, 7: -33.28821096898486, 8: -0.020331201708508627,
    },
    10: {
        0: -0.9371424300859873, 3: 5.186372428844064, 4: 1.0914373489967295, 5: -8.149787010746927,
        6: -18.52006565999696, 7: 22.739487099350505, 8: 2.4936055526796523, 9: -3.0467644718982196,
    },
    11: {
        0: 2.273310147516538, 3: -10.53449546673725, 4: -2.0008720582248625, 5: -17.9589318631188,
        6: 27.94888452941996, 7: -2.8589982771350235, 8: -8.87285693353063, 9: 12.360567175794303,
        10: 0.6433927460157636,
    },
    12: {
        0: 0.054293734116568765, 5: 4.450312892752409, 6: 1.8915178993145003, 7: -5.801203960010585,
        8: 0.3111643669578199, 9: -0.1521609496625161, 10: 0.20136540080403034, 11: 0.04471061572777259,
    },
    13: {
        0: 0.056167502283047954, 6: 0.25350021021662483, 7: -0.2462390374708025, 8: -0.12419142326381637,
        9: 0.15329179827876568, 10: 0.00820105229563469, 11: 0.007567897660545699, 12: -0.008298,
    },
    14: {
        0: 0.03183464816350214, 5: 0.028300909672366776, 6: 0.053541988307438566, 7: -0.05492374857139099,
        10: -0.00010834732869724932, 11: 0.0003825710908356584, 12: -0.00034046500868740456,
        13: 0.1413124436746325,
    },
    15: {
        0: -0.42889630158379194, 5: -4.697621415361164, 6: 7.683421196062599, 7: 4.06898981839711,
        8: 0.3567271874552811, 12: -0.0013990241651590145, 13: 2.9475147891527724, 14: -9.15095847217987,
    },
}  # fmt: skip
"""Row 12 ends the step; rows 13 to 15 serve the output between steps alone."""
DOP853_C = (
    0.0, 0.05260015195876773, 0.0789002279381516, 0.1183503419072274,
    0.2816496580927726, 0.3333333333333333, 0.25, 0.3076923076923077,
    0.6512820512820513, 0.6, 0.8571428571428571, 1.0,
    1.0, 0.1, 0.2, 0.7777777777777778,
)  # fmt: skip
DOP853_E: Rows = {
    0: {
        0: -0.18980075407240762, 5: 4.450312892752409, 6: 1.8915178993145003, 7: -5.801203960010585,
        8: -0.4226823213237919, 9: -0.1521609496625161, 10: 0.20136540080403034, 11: 0.02265179219836082,
    },
    1: {
        0: 0.01312004499419488, 5: -1.2251564463762044, 6: -0.4957589496572502, 7: 1.6643771824549864,
        8: -0.35032884874997366, 9: 0.3341791187130175, 10: 0.08192320648511571, 11: -0.022355307863886294,
    },
}  # fmt: skip
"""Errors of orders 3 and 5."""
DOP853_D: Rows = {
    0: {
        0: -8.428938276109013, 5: 0.5667149535193777, 6: -3.0689499459498917, 7: 2.38466765651207,
        8: 2.117034582445028, 9: -0.871391583777973, 10: 2.2404374302607883, 11: 0.6315787787694688,
        12: -0.08899033645133331, 13: 18.148505520854727, 14: -9.194632392478356, 15: -4.436036387594894,
    },
    1: {
        0: 10.427508642579134, 5: 242.28349177525817, 6: 165.20045171727028, 7: -374.5467547226902,
        8: -22.113666853125306, 9: 7.733432668472264, 10: -30.674084731089398, 11: -9.332130526430229,
        12: 15.697238121770845, 13: -31.139403219565178, 14: -9.35292435884448, 15: 35.81684148639408,
    },
    2: {
        0: 19.985053242002433, 5: -387.0373087493518, 6: -189.17813819516758, 7: 527.8081592054236,
        8: -11.57390253995963, 9: 6.8812326946963, 10: -1.0006050966910838, 11: 0.7777137798053443,
        12: -2.778205752353508, 13: -60.19669523126412, 14: 84.32040550667716, 15: 11.99229113618279,
    },
    3: {
        0: -25.69393346270375, 5: -154.18974869023643, 6: -231.5293791760455, 7: 357.6391179106141,
        8: 93.40532418362432, 9: -37.45832313645163, 10: 104.0996495089623, 11: 29.8402934266605,
        12: -43.53345659001114, 13: 96.32455395918828, 14: -39.17726167561544, 15: -149.72683625798564,
    },
}  # fmt: skip


def _dopri5_output(theta: float) -> Float:
    powers = theta ** np.arange(1, 5)
    weights: Float = powers @ _table(DOPRI5_OUTPUT, (4, 7))
    return weights


def _dop853_output(theta: float) -> Float:
    """Hairer's nested form, outermost last: factors theta and 1 - theta in turn."""
    end = _A8[12]
    first, last = np.eye(16)[0], np.eye(16)[12]
    parts = [end, first - end, 2.0 * end - (first + last), *_table(DOP853_D, (4, 16))]
    weights = np.zeros(16)
    for i, part in enumerate(reversed(parts)):
        weights = (weights + part) * (theta if i % 2 == 0 else 1.0 - theta)
    return weights


_A5, _A8 = _table(DOPRI5_A, (7, 7)), _table(DOP853_A, (16, 16))
DOPRI5 = Tableau(5, 4, 7, _A5, _A5.sum(axis=1), _table(DOPRI5_E, (1, 7)), _dopri5_output)
DOP853 = Tableau(8, 7, 13, _A8, np.array(DOP853_C), _table(DOP853_E, (2, 13))[::-1].copy(), _dop853_output)
