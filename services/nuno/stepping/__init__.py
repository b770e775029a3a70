"""Frames of whatever is stepped, in one way for cloth and dye: stepped, published, kept, resumed and compared. What is
the cloth's own belongs to `nuno.simulation`, what is the dye's to `nuno.dye`.
"""
