"""Values that beamfield calibrated: advice to calibrate them means nothing."""

from __future__ import annotations

from collections.abc import Iterator

from beamfield.finding import Finding
from beamfield.stacks.doctor.subject import Subject
from beamfield.stacks.files.calibration_record import is_as_calibrated

# What calibration weighed against its effect on the posterior, on windows of a log held out.
SETTLED = frozenset(
    ("nearly-flat", "absurdly-sharp", "weights-sum", "sigma-huge", "sigma-below-resolution", "distance-limit",
     "many-beams-in-product", "few-usable-beams", "motion-noise-wide")
)  # fmt: skip


def is_calibrated(subject: Subject) -> bool:
    """Whether the file has the very values that beamfield calibrated, by its record of them."""
    file, usable = subject.file, not subject.typed.unusable
    return usable and is_as_calibrated(file.section.text, file.stack, file.model, subject.parameters)


def calibrated(subject: Subject) -> Iterator[Finding]:
    """Report values that a calibration wrote."""
    if is_calibrated(subject):
        yield subject.finding(
            "calibrated", "info", "all values are as `beamfield calibrate --stack` wrote them",
            "they were chosen by the posterior they make on held-out parts of a log: advice to calibrate, to use other "
            "widths or fewer beams is left out",
            "nothing; calibrate again if the sensor, the map or the place changes",
        )  # fmt: skip
