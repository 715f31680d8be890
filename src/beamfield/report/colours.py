"""The colours of the report's figures; those of causes are in the order of `beamfield.models.beam_density.CAUSES`."""

# Okabe and Ito's palette: told apart by colour-blind readers, and in grey by their lightness.
CAUSE_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
THROUGH = "#7A0177"
DATA = "#B9C2CC"
MODEL = "#111111"
FIT = "#0072B2"
HELD_OUT = "#D55E00"
QUIET = "#5B6570"
GRID = "#E3E7EB"
