"""JSON Schemas of the documents, made from their types: `python -m
tests.unit.params.generate`.
"""

import json
from collections.abc import Mapping
from pathlib import Path

import msgspec

from seqid_cli.params.files import write_text_atomic
from seqid_cli.params.results import (
    diagnosis,
    drive,
    inspection,
    payload,
    plan,
    prediction,
    replay,
    trend,
)
from seqid_cli.params.schema import SCHEMA, ParameterFile
from seqid_cli.robot.toml_schema import SCHEMA as ROBOT_SCHEMA
from seqid_cli.robot.toml_schema import RobotFile
from tests import ROOT

SCHEMA_FOLDER = ROOT / "seqid_cli" / "params" / "schemas"
DOCUMENTS: Mapping[str, type[msgspec.Struct]] = {
    SCHEMA: ParameterFile,
    prediction.PREDICTION_SCHEMA: prediction.PredictionFile,
    diagnosis.DIAGNOSIS_SCHEMA: diagnosis.DiagnosisFile,
    inspection.INSPECTION_SCHEMA: inspection.InspectionFile,
    plan.PLAN_SCHEMA: plan.PlanFile,
    payload.PAYLOAD_SCHEMA: payload.PayloadFile,
    drive.DRIVE_SCHEMA: drive.DriveFile,
    replay.REPLAY_SCHEMA: replay.ReplayFile,
    trend.TREND_SCHEMA: trend.TrendFile,
    ROBOT_SCHEMA: RobotFile,
}


def schema_path(name: str) -> Path:
    return SCHEMA_FOLDER / (name.removeprefix("seqid/").replace("@", "-") + ".json")


def json_schema(name: str) -> dict[str, object]:
    document = DOCUMENTS[name]
    (reference,), components = msgspec.json.schema_components(
        [document], ref_template="#/$defs/{name}"
    )
    # The name of the schema is a plain string to the decoder, which must read other
    # versions too.
    components[document.__name__]["properties"]["schema"] = {"const": name}
    schema = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": name,
        **reference,
        "$defs": components,
    }
    # Defaults as JSON has them: lists for tuples.
    return dict(json.loads(msgspec.json.encode(schema)))


if __name__ == "__main__":
    for own in DOCUMENTS:
        written = json.dumps(json_schema(own), indent=2, sort_keys=True) + "\n"
        write_text_atomic(schema_path(own), written)
