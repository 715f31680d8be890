"""Beluga's AMCL: its three measurement models, emulated."""

from beamfield.stacks.beluga.beam import BelugaBeam
from beamfield.stacks.beluga.field import BelugaField, BelugaFieldProb

__all__ = ["BelugaBeam", "BelugaField", "BelugaFieldProb"]
