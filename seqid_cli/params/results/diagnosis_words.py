"""Whether a diagnosis may say that nothing but noise is left, in words."""

from seqid_cli.params.evidence_schema import EvidenceEntry
from seqid_cli.params.results.diagnosis import MORE_THAN_NOISE, DiagnosisFile, ResidualEntry

_NOT_WHITE = "not white"
_MEASURES = {"driving_load": "load times direction"}


def nothing_found(file: DiagnosisFile) -> str:
    """Return the sentence of a diagnosis without findings."""
    rest = {name: text for name, joint in file.joints.items() if (text := beyond_noise(joint))}
    if not rest:
        return "Nothing is missing: what these logs leave of the torque is noise."
    if set(rest.values()) == {_NOT_WHITE}:
        return (
            "No effect was found. What is left is no larger than slow noise may be, but it is "
            f"{_NOT_WHITE} ({', '.join(rest)})."
        )
    each = "; ".join(f"{name}: {text}" for name, text in rest.items())
    return f"No effect was found, but not all that is left is noise ({each})."


def beyond_noise(joint: ResidualEntry) -> str:
    """Return why the residual of a joint may be more than noise; empty where it looks like it."""
    larger = times_noise(joint, joint.rmse)
    slow = not joint.white and joint.rmse is not None
    return ", ".join([*([larger] if larger else []), *([_NOT_WHITE] if slow else [])])


def times_noise(joint: ResidualEntry, rmse: float | None) -> str:
    """Return by how much an error is larger than noise makes it; empty where it is not."""
    if not rmse or not joint.noise_floor:
        return ""
    limits = joint.noise_floor_interval
    most = limits[1] if limits else MORE_THAN_NOISE * joint.noise_floor
    if rmse <= most:
        return ""
    times, allowed = rmse / joint.noise_floor, most / joint.noise_floor
    return f"{times:.3g} times the noise floor, noise makes up to {allowed:.3g}"


def over_words(shown: EvidenceEntry) -> str:
    """Return the quantity that a residual is shown over, in words, without its unit."""
    if shown.quantity == "torque":
        return "the effect's own torque"
    if shown.quantity == "wave":
        return "place on its wave"
    other = "" if shown.of == shown.joint else f" of {shown.of}"
    return f"{_MEASURES.get(shown.quantity, shown.quantity)}{other}"
