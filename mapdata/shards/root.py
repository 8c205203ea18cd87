"""`Root`: a dataset in a folder, at a URL or in several of them, read a shard at a time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

from mapdata.limits import Size
from mapdata.movement import Movement
from mapdata.search.labels import Labels
from mapdata.shards.arrays import Shard, decode
from mapdata.shards.dataset_files import load_manifest, local_shard_path
from mapdata.shards.errors import REPAIRS, ShardError
from mapdata.shards.locations import Locations, locations
from mapdata.shards.manifest import Entry, Manifest
from mapdata.shards.reader import open_shard
from mapdata.shards.workers import bar


class RootShard(NamedTuple):
    """A shard of a `Root`.

    Attributes:
        location: index of its folder or URL in ``Root.locations``.
        first_map: number of maps in the locations before it. Map i of its own location is map
            ``first_map + i`` of the root.
        entry: the shard's entry in the manifest of its location.
    """

    location: int
    first_map: int
    entry: Entry


@dataclass(frozen=True)
class Root:
    """The dataset in a folder or at a URL, or the concatenated datasets of several of them.

    Attributes:
        locations: the folders and URLs.
        manifests: the manifest of each location.
        map_size: (rows, columns) of all maps.
        movement: rule of movement of all stored paths.
        shards: the finished shards in the order of their maps.
        maps: number of maps when all shards are finished.
        follow_links: whether files are read that are links out of their folder.
    """

    locations: tuple[str, ...]
    manifests: tuple[Manifest, ...]
    map_size: Size
    movement: Movement
    shards: tuple[RootShard, ...]
    maps: int
    follow_links: bool = False

    @staticmethod
    def open(source: Locations, *, complete: bool = False, follow_links: bool = False) -> Root:
        """Return the dataset in ``source``; no shard is opened yet.

        Args:
            source: a folder, a URL, or several of them, whose maps have one size and one movement,
                and all of them terrain or none.
            complete: refuse a dataset that is not finished.
            follow_links: read files that are links out of their folder. A folder of a stranger may
                have links to any file of this machine.

        Raises:
            DatasetNotFoundError: there is no dataset.
            ConnectionError: a URL cannot be reached, and its manifest is not in the cache.
            ShardError: a manifest is damaged.
            ValueError: ``source`` is empty; its datasets differ in map size or movement, or only
                some have terrain; a dataset is not finished; a URL needs a package that is not
                installed (the message names it).
        """
        names = locations(source)
        manifests = tuple(load_manifest(name, follow_links) for name in names)
        for name, manifest in zip(names, manifests, strict=True):
            _check_same_maps(names[0], manifests[0], name, manifest)
            if complete and not manifest.complete:
                raise ValueError(
                    f"root: {name} is not finished: run the command that makes it once more"
                )
        shards = []
        map_count = 0
        for index, manifest in enumerate(manifests):
            shards += [RootShard(index, map_count, entry) for entry in manifest.shards]
            map_count += manifest.maps
        return Root(
            locations=names,
            manifests=manifests,
            map_size=manifests[0].map_size,
            movement=manifests[0].movement,
            shards=tuple(shards),
            maps=map_count,
            follow_links=follow_links,
        )

    @property
    def has_terrain(self) -> bool:
        """Whether the maps have terrain."""
        return self.manifests[0].has_terrain

    @property
    def resolution(self) -> float:
        """Metres per cell of all maps.

        Raises:
            ValueError: the datasets of several locations have different ones.
        """
        first = self.manifests[0].resolution
        for manifest in self.manifests:
            if manifest.resolution != first:
                raise ValueError(
                    f"root: {self} have resolutions {first} and {manifest.resolution}; take those "
                    "of one alone"
                )
        return first

    def check_begun(self) -> None:
        """Refuse a dataset without any finished shard, such as a failed build leaves behind.

        Raises:
            ValueError: the message names the location, and says what to do.
        """
        for location, manifest in zip(self.locations, self.manifests, strict=True):
            if not manifest.shards:
                raise ValueError(
                    f"root: {location} holds none of its {manifest.maps} maps yet: no shard is "
                    "finished. Wait for the build that runs, or run the command that makes it once "
                    "more: it goes on, or says what stops it"
                )

    def __repr__(self) -> str:
        return f"Root({', '.join(map(repr, (*self.locations, *self.manifests)))})"

    def __str__(self) -> str:
        """Return the folders and URLs."""
        return ", ".join(self.locations)

    def open_shard(self, k: int) -> Shard:
        """Return shard ``k``, checked; a shard at a URL is fetched first.

        Raises:
            ShardError: it is missing, damaged, or holds other maps than the manifest says.
            DatasetNotFoundError: its URL has no such file.
            ConnectionError: its URL cannot be reached.
        """
        root_shard = self.shards[k]
        entry = root_shard.entry
        location = self.locations[root_shard.location]
        manifest = self.manifests[root_shard.location]
        path = local_shard_path(location, entry, self.follow_links)
        try:
            shard = open_shard(path, entry.bytes, entry.sha256)
        except FileNotFoundError:
            raise ShardError(
                f"{path}: missing; 'mapdata verify {location}' lists all missing files"
            ) from None
        has_header = shard.header == manifest.header(*entry.limits)
        if not has_header or shard.content_hash != entry.content_hash:
            raise ShardError(f"{path}: holds other maps than the manifest says; {REPAIRS}")
        return shard

    def shard_labels(self, k: int) -> Labels:
        """Return the maps of shard ``k`` with their labels; map numbers are those of the root.

        Raises:
            ShardError, DatasetNotFoundError, ConnectionError: as `open_shard`.
        """
        labels = decode(self.open_shard(k))
        index = labels.maps.index + self.shards[k].first_map
        return replace(labels, maps=replace(labels.maps, index=index))

    def labels(self, *, progress: bool = False) -> Iterator[Labels]:
        """Yield the maps with their labels, a shard at a time.

        Map numbers are consecutive over several locations: the first map of the second location
        has the number of maps that the first location has when it is finished.

        Raises:
            ShardError, DatasetNotFoundError, ConnectionError: as `open_shard`.
            ValueError: as `check_begun`.
        """
        self.check_begun()
        with bar(progress, sum(manifest.done for manifest in self.manifests)) as advance:
            for k, shard in enumerate(self.shards):
                yield self.shard_labels(k)
                advance(shard.entry.maps)

    def locate(self, index: int) -> tuple[Labels, int]:
        """Return the labels of the shard that holds map ``index``, and the row of the map in them.

        Raises:
            ValueError: the dataset has no such map, or as `check_begun`.
        """
        self.check_begun()
        for k, shard in enumerate(self.shards):
            local_index = index - shard.first_map  # number of the map in its own location
            if shard.entry.start <= local_index < shard.entry.stop:
                return self.shard_labels(k), local_index - shard.entry.start
        raise ValueError(f"index: got {index}, {self} holds maps 0 to {self.maps - 1}")


def _check_same_maps(
    first_location: str, first: Manifest, location: str, manifest: Manifest
) -> None:
    """Refuse a dataset whose maps do not go with those of the first location.

    They must have the same size and movement, and all of them must have terrain, or none.
    """
    for name in ("map_size", "movement"):
        expected = getattr(first, name)
        actual = getattr(manifest, name)
        if actual != expected:
            raise ValueError(
                f"root: {location} has {name} {actual}, {first_location} has {expected}; the roots "
                "of one dataset must have one"
            )
    if manifest.has_terrain != first.has_terrain:
        with_terrain, without = location, first_location
        if first.has_terrain:
            with_terrain, without = without, with_terrain
        raise ValueError(
            f"root: the maps of {with_terrain} have terrain, those of {without} have none; open "
            "them as datasets of their own"
        )
