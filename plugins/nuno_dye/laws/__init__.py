"""The physics of cells and of the faces between them: isotherms, adsorption, diffusivity, and the powers and logarithms
in them.
"""

from nuno_dye.laws.power import power as power
