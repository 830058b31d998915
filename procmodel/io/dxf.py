"""Drawings in DXF: contours read from them, and written for the drawing program.

Read are LINE, ARC, CIRCLE, LWPOLYLINE, POLYLINE, SPLINE and ELLIPSE of the modelspace, also inside
blocks that are inserted there; splines and ellipses become lines. Everything else (texts,
dimensions, points, hatches, external references) is passed over, as are hidden entities and layers
that are frozen or off.
"""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from procmodel.errors import InputError
from procmodel.io.atomic import check_target, writing
from procmodel.io.dxf_entities import KINDS, Outline3d, outlines
from procmodel.io.polyline import JOIN_TOLERANCE, BulgePolyline, checked, join_edges
from procmodel.io.textfile import read_bytes
from procmodel.io.units import conversion_factor

if TYPE_CHECKING:
    from ezdxf.document import Drawing
    from ezdxf.layouts import Modelspace

# The codes of $INSUNITS in which workpieces are drawn, with the length of each in mm.
INSUNITS = {
    1: ("inch", 25.4),
    2: ("foot", 304.8),
    4: ("mm", 1.0),
    5: ("cm", 10.0),
    6: ("m", 1000.0),
    8: ("microinch", 25.4e-6),
    9: ("mil", 25.4e-3),
    10: ("yard", 914.4),
    11: ("angstrom", 1e-7),
    12: ("nm", 1e-6),
    13: ("um", 1e-3),
    14: ("dm", 100.0),
}
_MILLIMETRES = 4

# Blocks inserted in blocks; deeper ones insert each other in a circle.
_DEEPEST = 16


@dataclass(frozen=True)
class _Entity:
    """Something drawn in the modelspace.

    Attributes
    ----------
    drawn : ezdxf entity
        The entity, in the coordinates of the modelspace.
    layer : str
        Layer on which it shows.
    label : str
        What to call it: `LINE 2F`, `LINE in block 'HOLE' (INSERT 31)`.
    """

    drawn: Any
    layer: str
    label: str


def read_dxf(
    path: str | os.PathLike[str],
    layer: str | None = None,
    units: str | None = None,
    tolerance: float = JOIN_TOLERANCE,
) -> list[BulgePolyline]:
    """Read the contours of a drawing.

    Parameters
    ----------
    path : path-like
        The file, as text or binary DXF.
    layer : str, optional
        Read only this layer, whose name may be in any case; without it, all that are shown.
    units : str, optional
        Unit of the drawing, `mm` or `inch`, where it does not state one itself.
    tolerance : float [mm]
        How far splines and ellipses may lie from the lines that stand for them, and how far apart
        two ends may be that are joined.

    Returns
    -------
    list of BulgePolyline
        At least one, in mm, layer by layer. Edges that were drawn one by one, in any order and
        direction, are joined end to end.

    Raises
    ------
    InputError
        If the file cannot be read, its unit is missing, unknown or another than `units`, the layer
        is missing or hidden, an entity does not lie in a plane of constant z, or the edges do not
        make contours (`procmodel.io.polyline.join_edges`, `checked`). The text names file, layer
        and entity.
    """
    path = Path(path)
    if not 0 < tolerance < math.inf:
        raise InputError(f"tolerance is {tolerance:g} mm: give a number greater than zero")
    # For its plain sentences about files that are missing, folders or unreadable.
    content = read_bytes(path)
    document, space, hidden = _open(path)
    # The library takes metres where the file has no such entry, as those of R12 often have not.
    code = document.header.get("$INSUNITS", 0) if b"$INSUNITS" in content else 0
    factor = _length_of_unit(path, code, units)
    if layer is not None and layer.lower() in hidden:
        raise InputError(
            f"{path}: layer '{layer}' is frozen or off: show it in the drawing program, "
            "or choose another layer"
        )
    by_layer: dict[str, list[_Entity]] = {}
    others: Counter[str] = Counter()
    for entity in _shown(path, space, hidden, None, 0):
        if entity.drawn.dxftype() in KINDS:
            by_layer.setdefault(entity.layer.lower(), []).append(entity)
        elif layer is None or entity.layer.lower() == layer.lower():
            others[entity.drawn.dxftype()] += 1
    if layer is not None:
        _check_layer(path, document, layer, by_layer)
        by_layer = {key: each for key, each in by_layer.items() if key == layer.lower()}
    if not by_layer:
        raise _nothing_drawn(path, layer, others)
    return [
        contour
        for entities in by_layer.values()
        for contour in _contours(path, entities, factor, tolerance)
    ]


def write_dxf(
    path: str | os.PathLike[str],
    polylines: Sequence[BulgePolyline],
    layers: Sequence[str] | None = None,
) -> None:
    """Write contours as polylines (LWPOLYLINE) of a drawing in mm, version R2010.

    Parameters
    ----------
    path : path-like
        The file; one already there is replaced, completely or not at all. The same contours give
        the same file to the byte.
    polylines : sequence of BulgePolyline
        At least one.
    layers : sequence of str, optional
        Layer of each; without it all are on the layer `CONTOUR`.

    Raises
    ------
    InputError
        If the file cannot be written, there is no contour, one is faulty (`checked`), or the
        layers are not as many as the contours or have a name that drawings do not allow.
    """
    check_target(Path(path))
    if layers is None:
        layers = ["CONTOUR"] * len(polylines)
    if not polylines:
        raise InputError(f"{path}: there is no contour to write: give at least one")
    if isinstance(layers, str) or len(layers) != len(polylines):
        raise InputError(
            f"{path}: {len(polylines)} contours but layers are {layers!r}: give one name for each"
        )
    for polyline in polylines:
        checked(polyline)
    for name in layers:
        if not name.strip() or set(name) & set('<>/\\":;?*=`|,') or not name.isprintable():
            raise InputError(
                f"{path}: layer {name!r} has a name that drawings do not allow: "
                "use letters, digits, blanks, '_' and '-'"
            )
    import ezdxf

    options = ezdxf.options
    usual = options.write_fixed_meta_data_for_testing
    try:
        # Else the file would hold the time and random identifiers.
        options.write_fixed_meta_data_for_testing = True
        document = ezdxf.new("R2010", units=_MILLIMETRES)
        space = document.modelspace()
        for name, polyline in zip(layers, polylines, strict=True):
            if name not in document.layers:
                document.layers.add(name)
            bulges = np.zeros(len(polyline.points))
            bulges[: len(polyline.bulges)] = polyline.bulges
            space.add_lwpolyline(
                np.column_stack([polyline.points, bulges]).tolist(),
                format="xyb",
                close=polyline.closed,
                dxfattribs={"layer": name},
            )
        # The library adds these from a set, in an order that changes from run to run.
        classes = document.classes
        classes.add_required_classes(document.dxfversion)
        classes.classes = dict(sorted(classes.classes.items()))
        with writing(path) as draft:
            document.saveas(draft)
    finally:
        options.write_fixed_meta_data_for_testing = usual


def _open(path: Path) -> tuple[Drawing, Modelspace, dict[str, bool]]:
    """The drawing, its modelspace and its hidden layers."""
    import ezdxf

    try:
        document = ezdxf.readfile(path)
        return document, document.modelspace(), _hidden_layers(document)
    except Exception as error:
        # Damage reaches every part of the parser, which raises errors of a dozen unrelated types;
        # each of them means the same here.
        reason = " ".join(str(error).split()).rstrip(".") or type(error).__name__
        raise InputError(
            f"{path}: this is not a DXF drawing, or it is damaged ({reason.replace(str(path), '')})"
            ": save it anew from the drawing program"
        ) from error


def _length_of_unit(path: Path, code: object, units: str | None) -> float:
    """Length in mm of the drawing's unit, by the drawing itself or as given."""
    given = conversion_factor(units, "mm") if units is not None else None
    if code in (0, None):
        if given is None:
            raise InputError(
                f"{path}: the drawing does not state its unit ($INSUNITS is 0): "
                'give units="mm" or set the unit in the drawing program'
            )
        return given
    if not isinstance(code, int) or code not in INSUNITS:
        raise InputError(
            f"{path}: the drawing's unit, $INSUNITS {code}, is unknown or not one of workpieces: "
            "set it to 4 (mm) in the drawing program"
        )
    name, stated = INSUNITS[code]
    if given is not None and not math.isclose(given, stated, rel_tol=1e-9):
        raise InputError(
            f"{path}: the drawing states its unit as {name} ($INSUNITS {code}), but units is "
            f"'{units}': leave units out, or correct the drawing"
        )
    return stated


def _hidden_layers(document: Drawing) -> dict[str, bool]:
    """Names of layers that are not shown, in lower case, and whether they are frozen."""
    return {
        layer.dxf.name.lower(): layer.is_frozen()
        for layer in document.layers
        if layer.is_frozen() or layer.is_off()
    }


def _shown(
    path: Path,
    entities: Iterable[Any],
    hidden: dict[str, bool],
    insert: _Entity | None,
    depth: int,
) -> Iterator[_Entity]:
    """Entities that are shown, those in inserted blocks in the coordinates of the modelspace."""
    for drawn in entities:
        kind = drawn.dxftype()
        layer = _attribute(drawn, "layer", "0")
        label = f"{kind} {_attribute(drawn, 'handle', '')}"
        if insert is not None:
            # What is drawn on layer 0 of a block shows on the layer of its insertion.
            layer = insert.layer if layer == "0" else layer
            label = f"{kind} in {insert.label}"
        entity = _Entity(drawn, layer, label)
        # An insertion on a layer that is off, unlike frozen, still shows its other layers.
        if hidden.get(layer.lower(), False) or _attribute(drawn, "invisible", 0):
            continue
        if kind == "INSERT" and not drawn.is_xref():
            yield from _inserted(path, entity, hidden, insert, depth)
        elif layer.lower() not in hidden:
            yield entity


def _attribute(drawn: Any, name: str, default: Any) -> Any:
    # Kinds that the library does not know have no layer, and asking for it raises.
    return drawn.dxf.get(name, default) if drawn.dxf.is_supported(name) else default


def _inserted(
    path: Path, entity: _Entity, hidden: dict[str, bool], insert: _Entity | None, depth: int
) -> Iterator[_Entity]:
    """Entities of an inserted block."""
    drawn, place = entity.drawn, f"{path}, layer {entity.layer}, {entity.label}"
    block = drawn.dxf.get("name", "")
    if depth >= _DEEPEST:
        raise InputError(
            f"{place}: blocks are inserted in each other more than {_DEEPEST} deep, or in a "
            "circle: explode them"
        )
    if drawn.block() is None:
        raise InputError(f"{place}: block '{block}' is not in the drawing: delete the insertion")
    label = insert.label if insert is not None else f"block '{block}' ({entity.label})"

    def refuse(part: Any, reason: str) -> None:
        if part.dxftype() in KINDS:
            raise InputError(
                f"{place}: {part.dxftype()} of block '{block}' cannot be placed ({reason}): "
                "explode the block"
            )

    parts: list[Any] = []
    try:
        for single in drawn.multi_insert() if drawn.mcount > 1 else [drawn]:
            parts += single.virtual_entities(skipped_entity_callback=refuse)
    except InputError:
        raise
    except Exception as error:
        # As in `_open`: the parser accepts values that its geometry then stumbles over.
        raise InputError(
            f"{place}: block '{block}' cannot be placed ({error}): explode the block"
        ) from error
    yield from _shown(path, parts, hidden, replace(entity, label=label), depth + 1)


def _check_layer(
    path: Path, document: Drawing, layer: str, drawn_on: dict[str, list[_Entity]]
) -> None:
    if layer.lower() in drawn_on or layer in document.layers:
        return
    names = {each.dxf.name.lower(): each.dxf.name for each in document.layers}
    names |= {key: entities[0].layer for key, entities in drawn_on.items()}
    raise InputError(
        f"{path}: there is no layer '{layer}': choose one of {', '.join(sorted(names.values()))}"
    )


def _nothing_drawn(path: Path, layer: str | None, others: Counter[str]) -> InputError:
    where = f"on layer '{layer}'" if layer is not None else "on the layers that are shown"
    passed_over = ", ".join(f"{count} {kind}" for kind, count in sorted(others.items()))
    remark = f" (passed over: {passed_over})" if others else ""
    return InputError(
        f"{path}: no line, arc, circle, polyline, spline or ellipse {where}{remark}: "
        "draw the contour in the modelspace, or choose another layer"
    )


def _contours(
    path: Path, entities: Sequence[_Entity], factor: float, tolerance: float
) -> list[BulgePolyline]:
    """Contours of one layer."""
    layer = f"{path.name}, layer {entities[0].layer}"
    edges: list[BulgePolyline] = []
    height: float | None = None
    for entity in entities:
        place = f"{layer}, {entity.label}"
        for drawn in _outlines_in_mm(place, entity, factor, tolerance):
            z = drawn.points[:, 2]
            height = float(z[0]) if height is None else height
            _check_plane(place, z, height, tolerance)
            edges.append(BulgePolyline(drawn.points[:, :2], drawn.bulges, drawn.closed, place))
    if not edges:
        raise InputError(f"{layer}: the polylines have no points: draw the contour again")
    return [
        checked(replace(chain, name=f"{layer}, contour {number}"))
        for number, chain in enumerate(join_edges(edges, tolerance), start=1)
    ]


def _outlines_in_mm(
    place: str, entity: _Entity, factor: float, tolerance: float
) -> list[Outline3d]:
    try:
        drawn = [
            Outline3d(each.points * factor, each.bulges, each.closed)
            for each in outlines(entity.drawn, tolerance / factor)
        ]
    except InputError as error:
        raise InputError(f"{place}: {error}") from error
    except Exception as error:
        # As in `_open`: the parser accepts values that its geometry then stumbles over.
        raise InputError(
            f"{place}: its geometry cannot be worked out ({error}): draw it again"
        ) from error
    for each in drawn:
        if not (np.isfinite(each.points).all() and np.isfinite(each.bulges).all()):
            raise InputError(f"{place}: a coordinate is not a finite number: draw it again")
    return drawn


def _check_plane(place: str, z: np.ndarray, height: float, tolerance: float) -> None:
    if np.ptp(z) > tolerance:
        raise InputError(
            f"{place}: z varies from {z.min():g} to {z.max():g} mm: "
            "flatten the drawing to one plane"
        )
    if abs(z[0] - height) > tolerance:
        raise InputError(
            f"{place}: it lies at z = {z[0]:g} mm, what is drawn before it on the layer at "
            f"{height:g} mm: put them on layers of their own, or flatten the drawing"
        )
