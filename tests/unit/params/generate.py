"""JSON Schemas of the documents, made from their types: `python -m tests.unit.params.generate`."""

import json
from collections.abc import Mapping
from pathlib import Path

import msgspec

from seqid_cli.params.files import write_text_atomic
from seqid_cli.params.results.diagnosis import DIAGNOSIS_SCHEMA, DiagnosisFile
from seqid_cli.params.results.inspection import INSPECTION_SCHEMA, InspectionFile
from seqid_cli.params.results.payload import PAYLOAD_SCHEMA, PayloadFile
from seqid_cli.params.results.plan import PLAN_SCHEMA, PlanFile
from seqid_cli.params.results.prediction import PREDICTION_SCHEMA, PredictionFile
from seqid_cli.params.results.trend import TREND_SCHEMA, TrendFile
from seqid_cli.params.schema import SCHEMA, ParameterFile
from tests import ROOT

SCHEMA_FOLDER = ROOT / "seqid_cli" / "params" / "schemas"
DOCUMENTS: Mapping[str, type[msgspec.Struct]] = {
    SCHEMA: ParameterFile,
    PREDICTION_SCHEMA: PredictionFile,
    DIAGNOSIS_SCHEMA: DiagnosisFile,
    INSPECTION_SCHEMA: InspectionFile,
    PLAN_SCHEMA: PlanFile,
    PAYLOAD_SCHEMA: PayloadFile,
    TREND_SCHEMA: TrendFile,
}


def schema_path(name: str) -> Path:
    """Return where the JSON Schema of a document such as `seqid/params@1` ships."""
    return SCHEMA_FOLDER / (name.removeprefix("seqid/").replace("@", "-") + ".json")


def json_schema(name: str) -> dict[str, object]:
    """Return the JSON Schema (draft 2020-12) of a document such as `seqid/params@1`."""
    document = DOCUMENTS[name]
    (reference,), components = msgspec.json.schema_components(
        [document], ref_template="#/$defs/{name}"
    )
    # The name of the schema is a plain string to the decoder, which must read other versions too.
    components[document.__name__]["properties"]["schema"] = {"const": name}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": name,
        **reference,
        "$defs": components,
    }


def main() -> None:
    """Write every schema into the package."""
    for name in DOCUMENTS:
        text = json.dumps(json_schema(name), indent=2, sort_keys=True) + "\n"
        write_text_atomic(schema_path(name), text)


if __name__ == "__main__":
    main()
