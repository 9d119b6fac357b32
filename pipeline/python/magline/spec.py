"""Specs that are built in Python, with one method for each stage.

The methods of `Spec` for tables, searches and stages are made from the same declarations that check a
spec. Their docstrings give meaning, unit and default of each key.
"""

from __future__ import annotations

import copy
import os
import re
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from magline import _html, _toml
from magline._stages import StageMethods
from magline.errors import SpecError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

if TYPE_CHECKING:
    from typing import TypeAlias

    from numpy.typing import NDArray

    from magline.runs import Check, Run

    #: A list, or a single value where the list has one entry.
    ListLike: TypeAlias = Sequence[Any] | NDArray[Any] | float
    TableLike: TypeAlias = "TableHandle | str"


@dataclass(frozen=True)
class TableHandle:
    """Table of a spec: files, or the result of a stage. It is an input of later stages.

    Attributes
    ----------
    name : str
        Name of the table.

    Examples
    --------
    >>> import magline
    >>> spec = magline.Spec("handles")
    >>> flights = spec.table("flights", "datasets/samples/simple_magnav/xyz.h5")
    >>> even = spec.resample(name="even", input=flights, rate_hz=10.0)
    >>> flights.name, str(even)
    ('flights', 'even')
    """

    name: str
    _spec: Spec = field(repr=False, compare=False)

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True)
class Axis:
    """Axis of a sweep. A stage with the axis as the value of a key runs for each value of the axis.

    Its text is ``$NAME``, for use in a ``where``: ``f"flight = '{plan}'"``.

    Attributes
    ----------
    name : str
        Name of the axis and of its key column.

    Examples
    --------
    >>> import magline
    >>> spec = magline.Spec("axes")
    >>> plan = spec.axis("plan", ["1003", "1004"])
    >>> plan.name, f"flight = '{plan}'"
    ('plan', "flight = '$plan'")
    """

    name: str
    _spec: Spec = field(repr=False, compare=False)

    def __str__(self) -> str:
        return f"${self.name}"


class Spec(StageMethods):
    """Spec of a pipeline.

    `table` declares input files, `axis` a sweep, and each method with the name of a stage adds this
    stage. They return handles, which are the inputs of later stages. Keys that are omitted are
    unset and have the default of the declaration. Only `check` and `run` compare the spec with the
    declarations and the data.

    Parameters
    ----------
    name : str
        Name of the pipeline.
    seed : int, optional
        Seed of all random draws. Default: 0.
    store : path, optional
        Folder of the store, or its address. Default: ``store``.
    folder : path, optional
        Folder to which the paths of the spec are relative. Default: the current folder.

    Examples
    --------
    >>> import magline, tempfile
    >>> spec = magline.Spec("builder", store=tempfile.mkdtemp())
    >>> sample = "datasets/samples/magnavjl_tl/magnavjl_tl.parquet"
    >>> names = {"time_s": "tt", "mag_1_uc_nt": "mag_1_uc", "flux_a_x_nt": "flux_a_x"}
    >>> names |= {"flux_a_y_nt": "flux_a_y", "flux_a_z_nt": "flux_a_z"}
    >>> flights = spec.table("flights", sample, flight="1", line="1", rename=names)
    >>> terms = spec.a_matrix(input=flights, vector="flux_a")
    >>> ridge = spec.axis("lambda", [0.0, 0.025])
    >>> fit = spec.fit(input=terms, model="tolles_lawson", target="mag_1_uc", lambda_=ridge)
    >>> spec.run().failures
    []
    """

    def __init__(
        self,
        name: str,
        *,
        seed: int | None = None,
        store: str | os.PathLike[str] = "store",
        folder: str | os.PathLike[str] | None = None,
    ) -> None:
        self._document: dict[str, Any] = {"name": name, "store": os.fspath(store)}
        if seed is not None:
            self._document["seed"] = seed
        self._folder = Path.cwd() if folder is None else Path(folder).absolute()
        self._file = Path("spec.toml")

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Spec:
        """Spec of a TOML file. Its paths are relative to the folder of the file.

        Raises
        ------
        SpecError
            If the file does not exist or is not TOML. `check` reports all other faults.
        """
        file = Path(path)
        try:
            keys = tomllib.loads(file.read_bytes().decode())
        except FileNotFoundError:
            raise SpecError(f"there is no spec {file}") from None
        except ValueError as fault:
            raise SpecError(f"{file} is not TOML: {fault}") from fault
        spec = cls.from_dict(keys, folder=file.parent)
        spec._file = file
        return spec

    @classmethod
    def from_dict(cls, keys: Mapping[str, Any], *, folder: str | os.PathLike[str] | None = None) -> Spec:
        """Spec of the keys of a TOML file.

        Parameters
        ----------
        keys : mapping
            Keys, as for `magline.run`.
        folder : path, optional
            Folder to which paths are relative. Default: the current folder.
        """
        spec = cls("", folder=folder)
        spec._document = copy.deepcopy({key: item for key, item in keys.items() if item is not None})
        return spec

    @property
    def name(self) -> str:
        """Name of the pipeline."""
        return str(self._document.get("name", ""))

    @property
    def folder(self) -> Path:
        """Folder to which the paths of the spec are relative."""
        return self._folder

    @property
    def tables(self) -> list[str]:
        """Names of all tables: those of files, then those of stages."""
        names = [one["name"] for one in _mappings(self._document.get("stages")) if isinstance(one.get("name"), str)]
        return [*_mapping(self._document.get("tables")), *names]

    @property
    def axes(self) -> dict[str, Axis]:
        """Axes of the sweep by name, with those of the search."""
        searched = _mapping(_mapping(self._document.get("search")).get("axes"))
        return {name: Axis(name, self) for name in [*_mapping(self._document.get("axes")), *searched]}

    def __getitem__(self, table: str) -> TableHandle:
        """Handle of a table.

        Raises
        ------
        KeyError
            If the spec has no table of this name.
        """
        if table not in self.tables:
            raise KeyError(f"the spec `{self.name}` has no table `{table}`; it has {', '.join(self.tables)}")
        return TableHandle(table, self)

    def axis(self, name: str, values: Sequence[Any] | NDArray[Any]) -> Axis:
        """Declares an axis of the sweep.

        A stage with the axis as the value of a key runs for each value of the axis.

        Parameters
        ----------
        name : str
            Name of the axis and of its key column.
        values : sequence
            Values of one type.

        Raises
        ------
        ValueError
            If an axis of this name has other values.
        """
        axes = self._document.setdefault("axes", {})
        listed = self._plain(values)
        if isinstance(listed, str) or not isinstance(listed, Sequence):
            raise TypeError(f"the values of the axis `{name}` are not a list: {values!r}")
        if name in self.axes and axes.get(name) != listed:
            raise ValueError(f"there is already an axis `{name}` with other values")
        axes[name] = listed
        return Axis(name, self)

    def stage(self, kind: str, /, **keys: Any) -> TableHandle:
        """Adds a stage by its kind, including stages, models, filters and metrics written in Python.

        Parameters
        ----------
        kind : str
            Kind of the stage.
        **keys
            Inputs and parameters, and ``name``, ``where``, ``publish``, ``carry``, ``keep``.
        """
        return self._stage(kind, keys)

    def publish(
        self,
        *,
        title: str,
        description: str,
        authors: Sequence[Mapping[str, str]],
        licence: str,
        date: str,
        contact: str,
        licence_url: str | None = None,
        licence_file: str | None = None,
        version: str | None = None,
        doi: str | None = None,
        url: str | None = None,
        keywords: Sequence[str] | None = None,
        include_inputs: bool | None = None,
        motivation: str | None = None,
        collection: str | None = None,
        uses: str | None = None,
        limits: str | None = None,
    ) -> None:
        """Declares the metadata of a published set, for ``magline publish``.

        Parameters
        ----------
        title : str
            Title of the data set.
        description : str
            Content and purpose of the data set, in a few sentences.
        authors : sequence of mapping
            Authors in the order of the citation: ``given`` and ``family``, or ``name``; optionally
            ``orcid`` and ``affiliation``.
        licence : str
            Licence as an SPDX identifier, such as ``CC-BY-4.0``, or another name with
            ``licence_url``.
        date : str
            Date of publication, ``YYYY-MM-DD``.
        contact : str
            Address for questions: e-mail or web.
        licence_url : str, optional
            Address of the licence's text. Unset: the address of the SPDX identifier.
        licence_file : str, optional
            File with the text of the licence. Unset: name and address only.
        version : str, optional
            Version of the data set, ``MAJOR.MINOR.PATCH``. Default: ``1.0.0``.
        doi : str, optional
            DOI, such as ``10.5281/zenodo.1234567``. Unset: none.
        url : str, optional
            Address of the data set's page. Unset: the address of the DOI.
        keywords : sequence of str, optional
            Keywords. Default: none.
        include_inputs : bool, optional
            Whether to copy the input files into the published set. Default: False.
        motivation, collection, uses, limits : str, optional
            Entries of the datasheet: purpose; method, place and equipment; uses; known faults.
            Unset: not provided.
        """
        given = {key: item for key, item in locals().items() if key != "self"}
        self._document["publish"] = self._keys(given)

    def to_dict(self) -> dict[str, Any]:
        """Copy of the keys of the spec, as in its TOML file."""
        return copy.deepcopy(self._document)

    def toml(self) -> str:
        """TOML text of the spec. Paths are relative to `folder`."""
        return _toml.document(_ordered(self._document))

    def write(self, path: str | os.PathLike[str]) -> Path:
        """Write the spec as a TOML file, which replaces an existing file.

        Relative paths of the spec are rewritten if the file is in another folder, so that they name the same files. The
        results have the same keys, so a run of the file computes only results that are missing from the store.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        OSError
            If the file cannot be written. An existing file is then unchanged.
        """
        file = Path(path)
        text = _toml.document(_ordered(_moved(self._document, self._folder, file.absolute().parent)))
        # A file that is replaced at once is never half written. A link stays a link.
        target = Path(os.path.realpath(file))
        handle, name = tempfile.mkstemp(prefix=f".{target.name}.", dir=target.parent)
        try:
            with os.fdopen(handle, "w", encoding="utf-8", newline="\n") as written:
                written.write(text)
            os.chmod(name, target.stat().st_mode & 0o777 if target.exists() else 0o666 & ~_umask())
            os.replace(name, target)
        except BaseException:
            os.unlink(name)
            raise
        return file

    def explain(self, *, set: Mapping[str, Any] | None = None) -> str:
        """Plan as text: tables, axes, stored results and cost of each stage.

        Parameters
        ----------
        set : mapping, optional
            Overrides, as for `magline.run`. Default: no overrides.
        """
        from magline import runs

        return runs._explain(self, set)

    def check(self, *, set: Mapping[str, Any] | None = None) -> Check:
        """Check the spec without running it. See `magline.check`."""
        from magline import runs

        return runs.check(self, set=set)

    def run(
        self,
        *,
        set: Mapping[str, Any] | None = None,
        threads: int | None = None,
        store: str | os.PathLike[str] | None = None,
        progress: bool | None = None,
    ) -> Run:
        """Run the spec: compute the results that are missing from the store. See `magline.run`."""
        from magline import runs

        return runs.run(self, set=set, threads=threads, store=store, progress=progress)

    def __repr__(self) -> str:
        return _html.visible(f"<magline.Spec {self.name}: {', '.join(self.tables)}>")

    def _repr_html_(self) -> str:
        return f"<pre>{_html.html(self.toml())}</pre>"

    def _stage(self, kind: str, given: Mapping[str, Any]) -> TableHandle:
        keys = self._keys(given)
        name = self._free(keys.pop("name", None), kind)
        stage: dict[str, Any] = {"name": name, "stage": kind}
        stage |= {key: keys.pop(key) for key in ("input", "where") if key in keys}
        self._document.setdefault("stages", []).append(stage | keys)
        return TableHandle(name, self)

    def _table(self, given: Mapping[str, Any]) -> TableHandle:
        keys = self._keys(given)
        name = self._free(keys.pop("name"), "table")
        self._document.setdefault("tables", {})[name] = keys
        return TableHandle(name, self)

    def _search(self, given: Mapping[str, Any]) -> None:
        axes = self._document.get("search", {}).get("axes", {})
        self._document["search"] = {**self._keys(given), "axes": axes}

    def _search_axis(self, given: Mapping[str, Any]) -> Axis:
        keys = self._keys(given)
        name, choices = keys.pop("name"), keys.pop("choices", None)
        if (choices is None) == (not keys):
            raise ValueError(f"the axis `{name}` requires either `choices`, or `low` and `high`")
        if name in self.axes:
            raise ValueError(f"there is already an axis `{name}`")
        axes = self._document.setdefault("search", {}).setdefault("axes", {})
        axes[name] = keys if choices is None else choices
        return Axis(name, self)

    def _free(self, name: str | None, kind: str) -> str:
        """The name if it is free; without a name, the kind with the first free number."""
        taken = self.tables
        if name is None:
            numbered = (f"{kind}_{number}" for number in range(2, len(taken) + 3))
            return next(one for one in [kind, *numbered] if one not in taken)
        if name in taken:
            raise ValueError(f"the spec `{self.name}` already has a table `{name}`")
        return name

    def _keys(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Keys of TOML for the arguments of a method, without those that are None."""
        found = {key.removesuffix("_"): item for key, item in given.items() if item is not None and key != "self"}
        return {key: self._plain(item) for key, item in found.items()}

    def _plain(self, item: Any) -> Any:
        """Value of TOML for an argument: handles by their names, and copies of lists and arrays."""
        if isinstance(item, (TableHandle, Axis)):
            if item._spec is not self:
                raise ValueError(f"`{item}` belongs to the spec `{item._spec.name}`, not to `{self.name}`")
            return str(item)
        if isinstance(item, os.PathLike):
            return os.fspath(item)
        if hasattr(item, "tolist"):
            item = item.tolist()
        if isinstance(item, Mapping):
            return {str(key): self._plain(one) for key, one in item.items() if one is not None}
        if isinstance(item, Sequence) and not isinstance(item, str):
            return [self._plain(one) for one in item]
        _toml.value(item)  # reports a value without a TOML equivalent
        return item


_ORDER = ["name", "seed", "store", "tables", "axes", "search", "stages", "publish"]


def _ordered(document: Mapping[str, Any]) -> dict[str, Any]:
    """Keys in the usual order; unknown keys are last, for `check` to report them."""
    return {key: document[key] for key in sorted(document, key=lambda key: [*_ORDER, key].index(key))}


# A spec of `from_dict` can have any form, which `check` reports.
def _mapping(item: Any) -> dict[str, Any]:
    """The item if it is a mapping, otherwise an empty one."""
    return item if isinstance(item, dict) else {}


def _mappings(item: Any) -> list[dict[str, Any]]:
    """The mappings in a list."""
    return [one for one in item if isinstance(one, dict)] if isinstance(item, list) else []


def _umask() -> int:
    """Permissions that new files of this process do not have."""
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


_NAMED = re.compile(r"[\w-]+")


def _moved(document: Mapping[str, Any], old: Path, new: Path) -> dict[str, Any]:
    """Keys of a spec whose paths are relative to `new` instead of `old`."""
    moved = copy.deepcopy(dict(document))
    if os.path.realpath(old) == os.path.realpath(new):
        return moved

    def relative(keys: dict[str, Any], key: str) -> None:
        path = keys.get(key)
        if isinstance(path, (str, os.PathLike)) and "://" not in os.fspath(path):
            keys[key] = os.path.relpath(old / path, new)

    if "store" not in moved:
        moved["store"] = "store"
    relative(moved, "store")
    relative(_mapping(moved.get("publish")), "licence_file")
    for table in map(_mapping, _mapping(moved.get("tables")).values()):
        relative(table, "path")
        if table.get("lines") != "auto":
            relative(table, "lines")
        # Other texts are names of built-in mappings.
        if not _NAMED.fullmatch(str(table.get("mapping", ""))):
            relative(table, "mapping")
    return moved
