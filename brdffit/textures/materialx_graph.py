"""Node graphs of MaterialX over images: what feeds an input, as an expression that can be evaluated on pixels.

The MaterialX package reads documents, resolves names, versions and defaults; here the graph behind an input is walked
once. Constants are folded, texture coordinates are kept as affine frames, nodes that the standard library builds from
others are followed into their own graphs. What has no meaning on pixels (noise, positions, geometry) raises
``NotEvaluated`` with the name of the node.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import MaterialX as mx
import numpy as np
from numpy.typing import NDArray

from brdffit.textures.frames import Frame
from brdffit.textures.materialx_ops import OPERATIONS, combine

CHANNELS = {"float": 1, "integer": 1, "boolean": 1, "vector2": 2, "color3": 3, "vector3": 3, "color4": 4, "vector4": 4}
_OUTPUTS = {"outr": 0, "outg": 1, "outb": 2, "outa": 3, "outx": 0, "outy": 1, "outz": 2, "outw": 3}
_MOST_DEPTH = 200
#: Exceptions of the MaterialX package, which have no common base.
ERRORS = (mx.Exception, mx.ExceptionParseError, mx.ExceptionFileMissing, mx.ExceptionFoundCycle,
          mx.ExceptionOrphanedElement, RuntimeError, LookupError)  # fmt: skip


class NotEvaluated(Exception):
    """A node without a meaning on pixels; the text names it."""


@dataclass(eq=False)
class Expression:
    """An operation on other expressions; ``kind`` is its category."""

    kind: str
    operation: Callable[..., NDArray]
    inputs: tuple[Any, ...] = ()

    def pictures(self) -> list[Picture]:
        """The images at the end of all branches, each once."""
        found: dict[int, Picture] = {}
        for each in self.inputs:
            found |= {id(picture): picture for picture in each.pictures()}
        return list(found.values())

    def evaluate(self, read: Callable[[Picture], NDArray], known: dict[int, NDArray]) -> NDArray:
        """(h, w, channels) or (1, 1, channels); each node once, ``known`` holds those that are done."""
        if id(self) not in known:
            known[id(self)] = self.operation(*(each.evaluate(read, known) for each in self.inputs))
        return known[id(self)]


@dataclass(eq=False)
class Constant:
    """A value (1, 1, channels)."""

    value: NDArray

    def pictures(self) -> list[Picture]:
        return []

    def evaluate(self, read: Callable[[Picture], NDArray], known: dict[int, NDArray]) -> NDArray:
        return self.value


@dataclass(eq=False)
class Coordinates:
    """Texture coordinates, (0, 0) at the lower left, after an affine map."""

    frame: Frame = field(default_factory=Frame)


@dataclass(eq=False)
class Picture:
    """An image node: its file, type, colour space, address mode, and the frame it is read in, y down."""

    path: Path
    type: str
    color_space: str
    wrap: str
    frame: Frame

    def pictures(self) -> list[Picture]:
        return [self]

    def evaluate(self, read: Callable[[Picture], NDArray], known: dict[int, NDArray]) -> NDArray:
        if id(self) not in known:
            known[id(self)] = read(self)
        return known[id(self)]


@dataclass(frozen=True)
class Scope:
    """A node whose own graph is walked, and where that node stands."""

    node: Any
    outer: Scope | None

    @property
    def key(self) -> tuple[str, ...]:
        return (self.node.getNamePath(), *(self.outer.key if self.outer else ()))


class Graph:
    """The walk through one document."""

    def __init__(self, path: Path, document: Any) -> None:
        self.path, self.document = path, document
        self._done: dict[tuple, Any] = {}
        self._under_way: set[tuple] = set()

    def of_input(self, node: Any, name: str, scope: Scope | None = None) -> Any:
        """The expression that feeds an input of a node, by default that of its definition; None where there is none.

        Raises:
            NotEvaluated: for what has no meaning on pixels.
        """
        port = node.getInput(name)
        if port is not None:
            return self._of_port(port, scope)
        definition = node.getNodeDef() if hasattr(node, "getNodeDef") else None
        port = definition.getActiveInput(name) if definition is not None else None
        if port is None:
            return None
        geometry = port.getDefaultGeomPropString()
        if geometry:
            return self._geometry(geometry, node)
        return constant_of(port) if port.hasValueString() else None

    def _of_port(self, port: Any, scope: Scope | None) -> Any:
        if port.getInterfaceName():
            if scope is not None:
                return self.of_input(scope.node, port.getInterfaceName(), scope.outer)
            owner = port.getParent()
            while owner is not None and owner.getCategory() != "nodegraph":
                owner = owner.getParent()
            inner = owner.getInput(port.getInterfaceName()) if owner is not None else None
            return self._of_port(inner, None) if inner is not None else None
        output = port.getConnectedOutput()
        if output is not None and output.getParent().getCategory() == "nodegraph":
            return self._of_output(output, scope)
        node = port.getConnectedNode()
        if node is not None:
            return _picked(self._of_node(node, port.getOutputString(), scope), port)
        if port.getNodeName() or port.getNodeGraphString():
            missing = port.getNodeName() or port.getNodeGraphString()
            raise NotEvaluated(f"'{missing}', which is not in the document")
        if port.getType() == "filename":
            return port
        return constant_of(port) if port.hasValueString() else None

    def _of_output(self, output: Any, scope: Scope | None) -> Any:
        node = output.getConnectedNode()
        if node is None:
            return constant_of(output) if output.hasValueString() else None
        return _picked(self._of_node(node, output.getOutputString(), scope), output)

    def _of_node(self, node: Any, output: str, scope: Scope | None) -> Any:
        key = (node.getNamePath(), output, scope.key if scope else ())
        if key not in self._done:
            if key in self._under_way:
                raise NotEvaluated(f"{_named(node)}, whose nodes go in a circle")
            if len(self._under_way) > _MOST_DEPTH:
                raise NotEvaluated(f"{_named(node)}, which lies too deep")
            self._under_way.add(key)
            try:
                self._done[key] = self._made(node, output, scope)
            finally:
                self._under_way.discard(key)
        return self._done[key]

    def _made(self, node: Any, output: str, scope: Scope | None) -> Any:
        category = node.getCategory()
        if category == "image":
            return self._picture(node, scope)
        if category == "texcoord":
            return self._coordinates(self.of_input(node, "index", scope), node)
        if category in ("geompropvalue", "UsdPrimvarReader") and node.getType() == "vector2":
            return Coordinates()
        if category == "normalmap":
            return self._normalmap(node, scope)
        if category == "rotate2d":
            return self._rotated(node, scope)
        if category == "extract":
            return self._extracted(node, scope)
        if category == "switch":
            return self._switched(node, scope)
        if category in OPERATIONS:
            names, operation = OPERATIONS[category]
            inputs = [self.of_input(node, name, scope) for name in names]
            if any(each is None for each in inputs):
                raise NotEvaluated(f"{_named(node)}, of which an input is missing")
            return _combined(category, operation, inputs, node)
        definition = node.getNodeDef()
        graph = definition.getImplementation() if definition is not None else None
        if graph is None or graph.getCategory() != "nodegraph":
            raise NotEvaluated(_named(node))
        port = graph.getOutput(output) if output else None
        port = port if port is not None else next(iter(graph.getOutputs()), None)
        if port is None:
            raise NotEvaluated(_named(node))
        return self._of_output(port, Scope(node, scope))

    def _picture(self, node: Any, scope: Scope | None) -> Any:
        port = self.of_input(node, "file", scope)
        text = port.getResolvedValueString() if port is not None and hasattr(port, "getResolvedValueString") else ""
        if not text:
            return self.of_input(node, "default", scope)
        if "<" in text:
            raise NotEvaluated(f"{_named(node)}, whose file '{text}' stands for several tiles")
        at = self.of_input(node, "texcoord", scope)
        if not isinstance(at, Coordinates):
            raise NotEvaluated(f"{_named(node)}, whose texture coordinates are no affine map of the mesh's")
        modes = {_text(self._port(node, name, scope)) or "periodic" for name in ("uaddressmode", "vaddressmode")}
        wrap = {"periodic": "tile", "clamp": "clamp"}.get(next(iter(modes)), next(iter(modes)))
        wrap = wrap if len(modes) == 1 else " and ".join(sorted(modes))
        space = port.getActiveColorSpace() if node.getType() in ("color3", "color4") else "none"
        file = self.path.parent / text.replace("\\", "/")
        return Picture(file, node.getType(), space, wrap, at.frame.flipped())

    def _port(self, node: Any, name: str, scope: Scope | None) -> Any:
        """The input that holds a plain value, through the interfaces of graphs."""
        port = node.getInput(name)
        while port is not None and port.getInterfaceName() and scope is not None:
            name, node, scope = port.getInterfaceName(), scope.node, scope.outer
            port = node.getInput(name)
        if port is None and node.getNodeDef() is not None:
            port = node.getNodeDef().getActiveInput(name)
        return port

    def _geometry(self, name: str, node: Any) -> Any:
        if name.startswith("UV"):
            return Coordinates()
        raise NotEvaluated(f"{_named(node)}, which asks for the geometry's {name}")

    def _coordinates(self, index: Any, node: Any) -> Coordinates:
        if isinstance(index, Constant) and float(index.value.flat[0]) != 0.0:
            raise NotEvaluated(f"{_named(node)}, the second set of texture coordinates")
        return Coordinates()

    def _normalmap(self, node: Any, scope: Scope | None) -> Any:
        value, scale = self.of_input(node, "in", scope), self.of_input(node, "scale", scope)
        if not isinstance(value, Expression | Picture | Constant) or scale is None:
            raise NotEvaluated(_named(node))
        return Expression("normalmap", _decoded_normal, (value, scale))

    def _rotated(self, node: Any, scope: Scope | None) -> Any:
        value, amount = self.of_input(node, "in", scope), self.of_input(node, "amount", scope)
        if not isinstance(value, Coordinates) or not isinstance(amount, Constant):
            raise NotEvaluated(_named(node))
        angle = np.radians(float(amount.value.flat[0]))
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        return Coordinates(Frame.of(turn, np.zeros(2)).after(value.frame))

    def _extracted(self, node: Any, scope: Scope | None) -> Any:
        value, index = self.of_input(node, "in", scope), self.of_input(node, "index", scope)
        if not isinstance(index, Constant) or value is None or isinstance(value, Coordinates):
            raise NotEvaluated(_named(node))
        return _channel(value, int(index.value.flat[0]))

    def _switched(self, node: Any, scope: Scope | None) -> Any:
        which = self.of_input(node, "which", scope)
        if not isinstance(which, Constant):
            raise NotEvaluated(_named(node))
        return self.of_input(node, f"in{int(which.value.flat[0]) + 1}", scope)


def _combined(category: str, operation: Callable[..., NDArray], inputs: list[Any], node: Any) -> Any:
    """An operation on inputs: folded where all are constants, kept affine where they are coordinates."""
    if any(isinstance(each, Coordinates) for each in inputs):
        frame = _affine(category, inputs)
        if frame is None:
            raise NotEvaluated(f"{_named(node)}, which bends texture coordinates")
        return Coordinates(frame)
    if not all(isinstance(each, Expression | Picture | Constant) for each in inputs):
        raise NotEvaluated(_named(node))
    if all(isinstance(each, Constant) for each in inputs):
        return Constant(np.asarray(operation(*(each.value for each in inputs)), np.float64))
    if category in ("constant", "dot", "convert"):
        return inputs[0]
    if category == "multiply":
        for one, other in (inputs, inputs[::-1]):
            if isinstance(one, Constant) and (one.value == 1.0).all():
                return other
    if category == "mix" and isinstance(inputs[2], Constant) and np.isin(inputs[2].value, (0.0, 1.0)).all():
        if np.ptp(inputs[2].value) == 0.0:
            return inputs[0] if inputs[2].value.flat[0] == 1.0 else inputs[1]
    return Expression(category, operation, tuple(inputs))


def _affine(category: str, inputs: list[Any]) -> Frame | None:
    """The frame of coordinates after an operation with a constant; None where it is not affine."""
    if category in ("constant", "dot", "convert"):
        return inputs[0].frame
    if len(inputs) != 2 or all(isinstance(each, Coordinates) for each in inputs):
        return None
    first = isinstance(inputs[0], Coordinates)
    at, constant = (inputs[0], inputs[1]) if first else (inputs[1], inputs[0])
    if not isinstance(constant, Constant):
        return None
    value = np.broadcast_to(constant.value.ravel(), 2) if constant.value.size == 1 else constant.value.ravel()[:2]
    linear, offset = at.frame.arrays
    if category == "add":
        return Frame.of(linear, offset + value)
    if category == "subtract":
        return Frame.of(linear, offset - value) if first else Frame.of(-linear, value - offset)
    if category == "multiply":
        return Frame.of(value[:, None] * linear, value * offset)
    if category == "divide" and first and (value != 0.0).all():
        return Frame.of(linear / value[:, None], offset / value)
    return None


def _decoded_normal(value: NDArray, scale: NDArray) -> NDArray:
    vectors = 2.0 * value[..., :3] - 1.0
    xy = vectors[..., :2] * (scale if scale.shape[-1] == 2 else scale[..., :1])
    return combine(xy, vectors[..., 2:])


def _channel(value: Any, index: int) -> Any:
    if isinstance(value, Constant):
        return Constant(value.value[..., index : index + 1])
    return Expression(f"channel {index}", lambda array: array[..., index : index + 1], (value,))


def _picked(value: Any, port: Any) -> Any:
    """One channel of ``value``, where the port names an output such as "outr" and the value has more channels."""
    index = _OUTPUTS.get(port.getOutputString())
    if index is None or not isinstance(value, Picture) or CHANNELS.get(port.getType(), 0) != 1:
        return value
    return _channel(value, index) if CHANNELS.get(value.type, 1) > index else value


def constant_of(port: Any) -> Constant | None:
    """The value of a port as (1, 1, channels); None for what holds no numbers."""
    if port.getType() not in CHANNELS:
        return None
    try:
        value = port.getValue()
        numbers = value.asTuple() if hasattr(value, "asTuple") else [value]
        array = np.array([float(number) for number in numbers], np.float64)
    except (TypeError, ValueError, *ERRORS) as error:
        raise NotEvaluated(f"'{port.getNamePath()}', whose value '{port.getValueString()}' is no number") from error
    if not np.isfinite(array).all():
        raise NotEvaluated(f"'{port.getNamePath()}', whose value '{port.getValueString()}' is not finite")
    return Constant(array.reshape(1, 1, -1))


def _text(port: Any) -> str:
    return port.getValueString() if port is not None else ""


def _named(node: Any) -> str:
    return f"'{node.getName()}' (<{node.getCategory()}>)"
