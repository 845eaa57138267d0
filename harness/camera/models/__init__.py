"""The camera models, one file each, and the table of them."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BeforeValidator, Discriminator, Tag
from pydantic_core import PydanticKnownError

from harness.camera.models.double_sphere import DoubleSphere
from harness.camera.models.equirectangular import Equirectangular
from harness.camera.models.eucm import ExtendedUnified
from harness.camera.models.hyperboloid import Mirror
from harness.camera.models.kannala_brandt import KannalaBrandt
from harness.camera.models.model import CameraModel
from harness.camera.models.ocam import OCam
from harness.camera.models.unified import Unified

BUILT_IN: dict[str, type[CameraModel]] = {
    "hyperboloid": Mirror,
    "unified": Unified,
    "eucm": ExtendedUnified,
    "double_sphere": DoubleSphere,
    "kannala_brandt": KannalaBrandt,
    "ocam": OCam,
    "equirectangular": Equirectangular,
}
"""The settings of every camera model of this program, by `kind`."""

MODELS = dict(BUILT_IN)
"""Any camera model, of this program or registered by a plug-in. A table without a `kind` is a hyperboloid."""

_ELSEWHERE = "elsewhere"


def _tag(value: Any) -> str:
    kind = value.get("kind", "hyperboloid") if isinstance(value, Mapping) else getattr(value, "kind", None)
    return kind if isinstance(kind, str) and kind in BUILT_IN else _ELSEWHERE


def _third_party(value: Any) -> CameraModel:
    """The settings of a third-party model; raises if there is no such model."""
    if isinstance(value, CameraModel):
        return value
    if not isinstance(value, Mapping):
        raise PydanticKnownError("model_type", {"class_name": "CameraModel"})
    kind = value["kind"]
    if not (isinstance(kind, str) and kind in MODELS):
        kinds = ", ".join(f"'{each}'" for each in MODELS)
        raise PydanticKnownError(
            "union_tag_invalid", {"discriminator": "'kind'", "tag": str(kind), "expected_tags": kinds}
        )
    return MODELS[kind].model_validate(value)


if TYPE_CHECKING:
    AnyModel = CameraModel
else:
    AnyModel = Annotated[
        Annotated[Mirror, Tag("hyperboloid")]
        | Annotated[Unified, Tag("unified")]
        | Annotated[ExtendedUnified, Tag("eucm")]
        | Annotated[DoubleSphere, Tag("double_sphere")]
        | Annotated[KannalaBrandt, Tag("kannala_brandt")]
        | Annotated[OCam, Tag("ocam")]
        | Annotated[Equirectangular, Tag("equirectangular")]
        | Annotated[Any, BeforeValidator(_third_party), Tag(_ELSEWHERE)],
        Discriminator(_tag),
    ]
    """The settings of any camera model, distinguished by `kind`."""


def carried_over(settings: Mapping[str, Any], kind: Any) -> dict[str, Any]:
    """The table of a camera model after its `kind` was changed: keys of the same name differ in meaning by model."""
    return dict(settings) if settings.get("kind", "hyperboloid") == kind else {"kind": kind}


def knows(kind: Any, key: str) -> bool:
    """Whether the settings of a camera model have a key; true if there is no such model, which is reported later."""
    return not (isinstance(kind, str) and kind in MODELS) or key in MODELS[kind].model_fields


__all__ = [
    "BUILT_IN",
    "MODELS",
    "AnyModel",
    "CameraModel",
    "DoubleSphere",
    "Equirectangular",
    "ExtendedUnified",
    "KannalaBrandt",
    "Mirror",
    "OCam",
    "Unified",
    "carried_over",
    "knows",
]
