"""Values that beamfield calibrated: advice to calibrate them means nothing."""

from __future__ import annotations

from collections.abc import Iterator

from beamfield.finding import Finding
from beamfield.stacks.doctor.subject import Subject
from beamfield.stacks.files.calibration_record import is_as_calibrated
from beamfield.stacks.files.typed_values import typed_fields

# What calibration weighed against its effect on the posterior, on windows of a log held out.
SETTLED = frozenset(
    ("nearly-flat", "absurdly-sharp", "weights-sum", "sigma-huge", "sigma-below-resolution", "distance-limit",
     "many-beams-in-product", "few-usable-beams", "motion-noise-wide")
)  # fmt: skip


def is_calibrated(subject: Subject) -> bool:
    """Whether the file has the very values that beamfield calibrated, by its record of them."""
    file, stack, motion = subject.file, subject.stack, None
    if stack.filter is not None and not stack.motion_elsewhere:
        typed = typed_fields(file.of_filter, stack.filter.motion)
        motion = typed.parameters
        if typed.unusable:
            return False
    usable = not subject.typed.unusable
    return usable and is_as_calibrated(file.section.text, file.stack, file.model, subject.parameters, motion)


def calibrated(subject: Subject) -> Iterator[Finding]:
    """Report values that a calibration wrote."""
    if is_calibrated(subject):
        both = "the measurement model" if subject.stack.motion_elsewhere else "the measurement and the motion model"
        yield subject.finding(
            "calibrated", "info", f"all values of {both} are as `beamfield calibrate --stack` wrote them",
            "replay on a log chose them: advice to calibrate, to use other widths, other noise or fewer beams is left "
            "out",
            "nothing; calibrate again if the sensor, the map or the place changes",
        )  # fmt: skip
