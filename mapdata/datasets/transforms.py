"""`check_transform` refuses a ``transform=`` that would move the map, but not its path."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import torch

GEOMETRIC_MODULES = ("_geometry", "_auto_augment", "autoaugment")
"""Modules of torchvision that hold only classes and functions that move pixels.

They are the geometric transforms of its version 2, and the automatic policies of both versions,
which shear, shift and rotate.
"""

GEOMETRIC_NAMES = (
    "CenterCrop",
    "ElasticTransform",
    "FiveCrop",
    "Pad",
    "RandomAffine",
    "RandomCrop",
    "RandomHorizontalFlip",
    "RandomPerspective",
    "RandomResizedCrop",
    "RandomRotation",
    "RandomVerticalFlip",
    "Resize",
    "TenCrop",
    "affine",
    "center_crop",
    "crop",
    "elastic_transform",
    "five_crop",
    "hflip",
    "pad",
    "perspective",
    "resize",
    "resized_crop",
    "rotate",
    "ten_crop",
    "vflip",
)
"""Names that move pixels in the modules of torchvision's version 1.

These modules also hold transforms that do not move pixels.
"""


def check_transform(transform: object) -> None:
    """Refuse a transform that is not callable, and torchvision's geometric transforms.

    Torchvision takes the first tensor of a sample, its map, for the image and leaves all other
    tensors unchanged. So a flip would move the obstacles, but neither start, goal and path nor
    masks and costs. Torchvision is not imported: its classes are known by the modules that define
    them.

    Raises:
        ValueError: it is not callable; it is a geometric transform, or a container that holds one.
    """
    if transform is None:
        return
    if not callable(transform):
        raise ValueError(f"transform: got {transform!r}, expected a function of a sample")
    name = next(_geometric_names(transform), None)
    if name is not None:
        raise ValueError(
            f"transform: got torchvision's {name}, which would move the map, but not start, goal, "
            "path, masks and costs; expected augment=True, which moves all of them, or a function "
            "of your own that does"
        )


def _geometric_names(transform: object) -> Iterator[str]:
    """Yield the names of the geometric transforms of torchvision in ``transform``.

    Containers of torchvision and torch, a ``Lambda`` and a ``partial`` are searched. A function or
    class of the user is not: it may well move every field.
    """
    ancestors = type(transform).__mro__
    for definition in (transform, *ancestors):  # a function, or an object of such a class
        name = getattr(definition, "__name__", "")
        if name and _is_geometric(definition, name):
            yield name
            return
    children: list[object] = []
    if any(_torchvision_module(ancestor) for ancestor in ancestors):
        children += getattr(transform, "transforms", ())  # the attribute of Compose and its like
        children.append(getattr(transform, "lambd", None))  # the attribute of Lambda
    elif isinstance(transform, torch.nn.Sequential):
        children += transform
    elif isinstance(transform, partial):
        children.append(transform.func)
    for child in children:
        yield from _geometric_names(child)


def _is_geometric(definition: object, name: str) -> bool:
    """Return whether a class or function is one of torchvision's that move pixels."""
    module = _torchvision_module(definition)
    if not module:
        return False
    return module in GEOMETRIC_MODULES or name in GEOMETRIC_NAMES


def _torchvision_module(definition: object) -> str:
    """Return the last name of the module that defines it, or "" if it is not torchvision's."""
    module = str(getattr(definition, "__module__", None))  # functions written in C may have none
    return module.rpartition(".")[2] if module.startswith("torchvision.") else ""
