"""Whether a diagnosis may say that nothing but noise is left, in words."""

from seqid_cli.params.evidence_schema import EvidenceEntry
from seqid_cli.params.results.diagnosis import MORE_THAN_NOISE, DiagnosisFile, ResidualEntry

_MEASURES = {"driving_load": "load times direction"}


def nothing_found(file: DiagnosisFile) -> str:
    """Return the sentence of a diagnosis without findings."""
    rest = {name: text for name, joint in file.joints.items() if (text := beyond_noise(joint))}
    if not rest:
        return "Nothing is missing: what these logs leave of the torque is noise."
    each = "; ".join(f"{name}: {text}" for name, text in rest.items())
    return f"No effect was found, but not all that is left is noise ({each})."


def beyond_noise(joint: ResidualEntry) -> str:
    """Return why the residual of a joint is more than noise; empty where it may be noise."""
    reasons = []
    if joint.rmse and joint.noise_floor:
        limits = joint.noise_floor_interval
        most = limits[1] if limits else MORE_THAN_NOISE * joint.noise_floor
        if joint.rmse > most:
            times, allowed = joint.rmse / joint.noise_floor, most / joint.noise_floor
            reasons.append(f"{times:.3g} times the noise floor, noise makes up to {allowed:.3g}")
    if not joint.white and joint.rmse is not None:
        reasons.append("not white")
    return ", ".join(reasons)


def over_words(shown: EvidenceEntry) -> str:
    """Return the quantity that a residual is shown over, in words, without its unit."""
    if shown.quantity == "torque":
        return "the effect's own torque"
    if shown.quantity == "wave":
        return "place on its wave"
    other = "" if shown.of == shown.joint else f" of {shown.of}"
    return f"{_MEASURES.get(shown.quantity, shown.quantity)}{other}"
