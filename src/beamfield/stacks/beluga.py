"""Beluga's AMCL: its three measurement models, emulated."""

from beamfield.stacks.beluga_beam import BelugaBeam
from beamfield.stacks.beluga_field import BelugaField
from beamfield.stacks.beluga_field_prob import BelugaFieldProb

__all__ = ["BelugaBeam", "BelugaField", "BelugaFieldProb"]
