"""What all services of a run share: their start, supervision and end, frames in lockstep, control, the log and the list
of runs.
"""
