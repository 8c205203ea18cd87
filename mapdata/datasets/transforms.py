"""Which functions cannot be the ``transform=`` of a dataset: torchvision's geometric ones."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import torch

GEOMETRIC_MODULES = ("_geometry", "_auto_augment", "autoaugment")
"""Modules of torchvision all of whose classes and functions move pixels: the geometric ones of its
version 2, and the automatic policies of both versions, which shear, shift and rotate."""

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
"""What moves pixels in the modules of torchvision's version 1, which also hold what does not."""


def check_transform(transform: object) -> None:
    """Refuse what cannot be called with a sample, and torchvision's geometric transforms.

    Torchvision takes the first tensor of a sample, its map, for the image and leaves all others as
    they are. So a flip would move the obstacles, but neither start, goal and path nor masks and
    costs. Torchvision is not imported: its classes are known by the modules that define them.

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

    They are found in containers of torchvision and torch, in a ``Lambda`` and in a ``partial``. A
    function or class of the user's own is not looked into: it may well move every field.
    """
    ancestors = type(transform).__mro__
    for definition in (transform, *ancestors):  # a function, or an object of such a class
        name = getattr(definition, "__name__", "")
        if name and _is_geometric(definition, name):
            yield name
            return
    children: list[object] = []
    if any(_module_in_torchvision(ancestor) for ancestor in ancestors):
        children += getattr(transform, "transforms", ())  # of Compose, RandomApply and their like
        children.append(getattr(transform, "lambd", None))  # of Lambda
    elif isinstance(transform, torch.nn.Sequential):
        children += transform
    elif isinstance(transform, partial):
        children.append(transform.func)
    for child in children:
        yield from _geometric_names(child)


def _is_geometric(definition: object, name: str) -> bool:
    """Return whether a class or function of this name is one of torchvision that moves pixels."""
    module = _module_in_torchvision(definition)
    return module in GEOMETRIC_MODULES or (module != "" and name in GEOMETRIC_NAMES)


def _module_in_torchvision(definition: object) -> str:
    """Return the last name of the module that defines it, nothing if it is not torchvision's."""
    module = str(getattr(definition, "__module__", None))  # functions written in C may have none
    return module.rpartition(".")[2] if module.startswith("torchvision.") else ""
