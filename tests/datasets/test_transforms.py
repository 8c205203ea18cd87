"""Torchvision's geometric transforms are refused wherever they stand; nothing else is.

Most tests need no torchvision: stand-ins have the names of its classes and modules. Those of the
real library run where it can be imported.
"""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable
from functools import partial
from importlib import import_module
from operator import itemgetter
from typing import Any

import pytest
import torch
from helpers import samples

from mapdata import MapDataModule, MapDataset, OnlineMapDataset, Sample
from mapdata.datasets.transforms import check_transform


def transform_of(module: str, name: str, **attributes: Any) -> Any:
    """Return an object of a class like torchvision's ``name``, defined in this module of its
    transforms.
    """
    family = type(name, (torch.nn.Module,), {"__module__": f"torchvision.transforms.{module}"})
    transform = family()
    for attribute, value in attributes.items():
        setattr(transform, attribute, value)
    return transform


def function_of(module: str, name: str) -> Callable[..., Any]:
    """Return a function like torchvision's ``name``, defined in this module of its transforms."""

    def function(image: Any, *_: Any) -> Any:
        return image

    function.__module__, function.__name__ = f"torchvision.transforms.{module}", name
    return function


FLIP = transform_of("v2._geometry", "RandomHorizontalFlip")
NOISE = transform_of("v2._misc", "GaussianNoise")
ROTATE = function_of("v2.functional._geometry", "rotate")
CHOICE = transform_of("v2._container", "RandomChoice", transforms=(NOISE, FLIP))
MODULES = torch.nn.ModuleList([NOISE, FLIP])


class OwnFlip(type(FLIP)):  # type: ignore[misc]
    """A user's class that inherits from a geometric transform."""


GEOMETRIC: dict[str, tuple[Any, str]] = {
    "version 2": (FLIP, "RandomHorizontalFlip"),
    "version 1": (transform_of("transforms", "RandomRotation"), "RandomRotation"),
    "policy of version 2": (transform_of("v2._auto_augment", "RandAugment"), "RandAugment"),
    "policy of version 1": (transform_of("autoaugment", "AugMix"), "AugMix"),
    "subclass": (OwnFlip(), "RandomHorizontalFlip"),
    "function of version 2": (ROTATE, "rotate"),
    "function of version 1": (function_of("functional", "hflip"), "hflip"),
    "partial": (partial(ROTATE, angle=90), "rotate"),
    "Lambda": (transform_of("v2._misc", "Lambda", lambd=ROTATE), "rotate"),
    "Lambda of version 1": (transform_of("transforms", "Lambda", lambd=ROTATE), "rotate"),
    "Compose": (
        transform_of("v2._container", "Compose", transforms=[NOISE, FLIP]),
        "RandomHorizontalFlip",
    ),
    "Compose of version 1": (
        transform_of("transforms", "Compose", transforms=[transform_of("transforms", "Resize")]),
        "Resize",
    ),
    "RandomApply": (
        transform_of("v2._container", "RandomApply", transforms=MODULES),
        "RandomHorizontalFlip",
    ),
    "Sequential": (torch.nn.Sequential(torch.nn.Identity(), FLIP), "RandomHorizontalFlip"),
    "nested": (
        transform_of("v2._container", "RandomOrder", transforms=[torch.nn.Sequential(CHOICE)]),
        "RandomHorizontalFlip",
    ),
}


@pytest.mark.parametrize("case", GEOMETRIC)
def test_a_geometric_transform_is_refused_by_name(case: str) -> None:
    """Also inside containers; the message says what to use instead."""
    transform, name = GEOMETRIC[case]
    with pytest.raises(ValueError, match=rf"transform: got torchvision's {name}, .*augment=True"):
        check_transform(transform)


class FlipsAllFields(torch.nn.Module):
    """A user's module that holds a geometric transform, and may well apply it to all fields."""

    def __init__(self) -> None:
        """Keep the flip."""
        super().__init__()
        self.transforms = [FLIP]

    def forward(self, sample: Sample) -> Sample:
        """Return the sample."""
        return sample


def resize(sample: Sample) -> Sample:
    """Return the sample; the name alone is one of torchvision's."""
    return sample


ACCEPTED: dict[str, Any] = {
    "nothing": None,
    "own function": resize,
    "own module": FlipsAllFields(),
    "values": NOISE,
    "values of version 1": transform_of("transforms", "ColorJitter"),
    "Compose of values": transform_of("v2._container", "Compose", transforms=[NOISE, resize]),
    "Lambda of an own function": transform_of("v2._misc", "Lambda", lambd=resize),
    "Sequential": torch.nn.Sequential(torch.nn.ReLU(), NOISE),
    "partial": partial(resize),
    "function written in C": torch.stack,
    "method written in C": torch.Tensor.float,
    "callable object": itemgetter(0),
}


@pytest.mark.parametrize("case", ACCEPTED)
def test_other_transforms_are_accepted(case: str) -> None:
    """What changes values alone, and what the user wrote."""
    check_transform(ACCEPTED[case])


@pytest.mark.parametrize(
    "make",
    [
        lambda transform: MapDataset(["nowhere"], transform=transform),
        lambda transform: OnlineMapDataset(samples.SPEC, transform=transform),
        lambda transform: MapDataModule("nowhere", transform=transform),
    ],
    ids=["MapDataset", "OnlineMapDataset", "MapDataModule"],
)
def test_everything_that_takes_a_transform_refuses_geometric_ones(
    make: Callable[[Any], object],
) -> None:
    """When it is made, before a dataset is looked for."""
    with pytest.raises(ValueError, match="transform: got torchvision's RandomHorizontalFlip"):
        make(FLIP)


# --- the real library ---------------------------------------------------------------------------


@pytest.fixture(scope="module", params=["", ".v2"], ids=["version 1", "version 2"])
def transforms(request: pytest.FixtureRequest) -> Any:
    """The transforms of torchvision, where it can be imported beside this version of torch."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return import_module(f"torchvision.transforms{request.param}")
        except (ImportError, RuntimeError) as error:  # RuntimeError: built for another torch
            pytest.skip(f"torchvision cannot be imported: {error}")


ARGUMENTS: dict[str, tuple[Any, ...]] = {
    "CenterCrop": (10,),
    "ConvertImageDtype": (torch.float64,),
    "ElasticTransform": (500.0,),
    "FiveCrop": (10,),
    "GaussianBlur": (3,),
    "GaussianNoise": (0.0, 0.01),
    "Normalize": ([0.5], [0.5]),
    "Pad": (2,),
    "RandomAdjustSharpness": (2, 1.0),
    "RandomAffine": ((30, 40),),
    "RandomAutocontrast": (1.0,),
    "RandomCrop": (10,),
    "RandomHorizontalFlip": (1.0,),
    "RandomInvert": (1.0,),
    "RandomPerspective": (0.9, 1.0),
    "RandomResize": (10, 20),
    "RandomResizedCrop": (10,),
    "RandomRotation": ((30, 40),),
    "RandomShortestSize": (10,),
    "RandomVerticalFlip": (1.0,),
    "RandomZoomOut": (0, (2.0, 3.0), 1.0),
    "Resize": (10,),
    "ScaleJitter": ((20, 20),),
    "TenCrop": (10,),
    "ToDtype": (torch.float64,),
}
"""Arguments with which a transform does something to every image of one channel, if it can."""

NO_ARGUMENTS = (
    "ColorJitter",
    "Grayscale",
    "Identity",
    "RandomChannelPermutation",
    "RandomGrayscale",
    "ToImage",
    "ToPureTensor",
)


def moves_cells(transform: Any) -> bool:
    """Return whether a transform moves a cell of an image, or changes the size of the image."""
    image = torch.zeros(1, 32, 32)
    image[0, 5, 9] = 1
    changed = transform(image)
    if not isinstance(changed, torch.Tensor) or changed.shape != image.shape:
        return True
    distance = (changed - changed.median()).abs()
    return int(distance.argmax()) != int(image.argmax())


def test_transforms_that_move_cells_are_refused(transforms: Any) -> None:
    """Of all of the library that can be called with a map, those that move a cell of it, and the
    policies that may.
    """
    torch.manual_seed(0)
    moved = {True: 0, False: 0}
    for name in dir(transforms):
        if not inspect.isclass(getattr(transforms, name)):
            continue
        if name not in (*ARGUMENTS, *NO_ARGUMENTS):
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            transform = getattr(transforms, name)(*ARGUMENTS.get(name, ()))
            is_geometric = moves_cells(transform)
        moved[is_geometric] += 1
        for contained in (transform, transforms.Compose([transform])):
            if is_geometric:
                with pytest.raises(ValueError, match=f"transform: got torchvision's {name}"):
                    check_transform(contained)
            else:
                check_transform(contained)
    assert min(moved.values()) >= 8
    for name in ("AutoAugment", "RandAugment", "TrivialAugmentWide", "AugMix"):
        with pytest.raises(ValueError, match=f"transform: got torchvision's {name}"):
            check_transform(getattr(transforms, name)())


def test_functions_and_containers_of_the_library(transforms: Any) -> None:
    """Its `hflip` and `rotate`, and its own containers with a flip in them."""
    functional = import_module(f"{transforms.__name__}.functional")
    flip = transforms.RandomHorizontalFlip()
    jitter = transforms.ColorJitter()
    for transform in (
        functional.hflip,
        partial(functional.rotate, angle=90),
        transforms.Lambda(functional.vflip),
        transforms.RandomApply([jitter, flip]),
        transforms.RandomChoice([jitter, flip]),
        transforms.RandomOrder([jitter, flip]),
        torch.nn.Sequential(jitter, flip),
    ):
        with pytest.raises(ValueError, match=r"transform: got torchvision's .*, which would move"):
            check_transform(transform)
    check_transform(functional.gaussian_blur)
    check_transform(transforms.RandomApply([jitter]))
    check_transform(transforms.Lambda(resize))


def test_a_change_of_values_leaves_the_other_fields(transforms: Any) -> None:
    """An accepted transform of version 2 changes the first field, the map, alone."""
    if not hasattr(transforms, "ToDtype"):
        pytest.skip("version 1 takes no samples")
    fields = ("map", "goal", "goal_mask", "path")
    arguments: dict[str, Any] = {"fields": fields, "length": 5, "dtype": "float32"}
    plain = OnlineMapDataset(samples.SPEC, **arguments)
    transform = transforms.Compose([transforms.GaussianBlur(3), transforms.Normalize([0.5], [0.5])])
    changed = OnlineMapDataset(samples.SPEC, **arguments, transform=transform)[3]
    samples.assert_same(changed, plain[3], without=("map",))
    assert not torch.equal(changed.map, plain[3].map)
