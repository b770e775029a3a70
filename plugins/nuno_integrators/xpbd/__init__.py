"""XPBD: springs, hinges and contact as compliant constraints, and the sweeps over them."""
