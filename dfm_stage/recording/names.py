"""Names by which the writer and the reader of a bag know things."""

from __future__ import annotations

MODEL_ATTACHMENT = "model.yaml"
PARAMETERS_ATTACHMENT = "parameters.yaml"
VERSIONS_ATTACHMENT = "versions.json"
DROPPED_KEY = "messages_dropped"     # custom data of metadata.yaml: messages the recorder lost
