"""The one place that compiles: flags, the cache folder, and how a template becomes one kernel a model.

A cached caller of Numba keeps using an edited callee of another module, silently. So the cache lives in a folder
named after the hash of all kernel sources: an edit anywhere starts a fresh one. A lobe of the user's own is bound into
our kernels; what is compiled with it lives in a folder named after the sources of all that is bound as well.
"""

from __future__ import annotations

import hashlib
import os
import sys
import types as python_types
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite.binding

#: The rooms whose kernels a room's kernels may call, itself included: an edit there makes its cache stale.
_KERNEL_ROOMS = {
    "fitting": ("models", "halfangle", "fitting"),
    "render": ("models", "halfangle", "render"),
    "nets": ("nets",),
    "learned": ("models", "halfangle", "fitting", "nets", "learned/kernels"),
    "probes": ("probes/kernels",),
    "microgeometry": ("models", "halfangle", "render", "microgeometry/kernels"),
    "neural": ("nets", "neural/kernels"),
}


def _cache_root() -> Path:
    base = os.environ.get("BRDFFIT_CACHE") or os.environ.get("NUMBA_CACHE_DIR")
    return Path(base) if base else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "brdffit"


def _cache_folder(group: str, base: Path) -> str:
    """Folder of compiled kernels below ``base``: the hash of every source that the group's kernels may stand on."""
    root = Path(__file__).parent
    digest = hashlib.sha256(Path(__file__).read_bytes())
    for room in _KERNEL_ROOMS[group]:
        for source in sorted((root / room).glob("*.py")):
            digest.update(source.name.encode() + source.read_bytes())
    return str(base / digest.hexdigest()[:16])


def _use_wide_vectors() -> None:
    """Ask for 512-bit vectors where the processor has them without a clock penalty (Ice Lake and later).

    LLVM prefers 256 bits there by default; our loops over nodes are faster with 512. The user's own
    NUMBA_CPU_NAME or NUMBA_CPU_FEATURES win.
    """
    if "NUMBA_CPU_NAME" in os.environ or "NUMBA_CPU_FEATURES" in os.environ:
        return
    features = llvmlite.binding.get_host_cpu_features()
    if features.get("avx512vbmi2"):
        os.environ["NUMBA_CPU_NAME"] = llvmlite.binding.get_host_cpu_name()
        os.environ["NUMBA_CPU_FEATURES"] = features.flatten() + ",-prefer-256-bit"


#: Where each room's kernels are kept: the hash goes below whatever folder the user chose.
CACHE_FOLDERS = {group: _cache_folder(group, _cache_root()) for group in _KERNEL_ROOMS}
# Numba reads its variables at import.
_use_wide_vectors()

import numba  # noqa: E402
from numba import typeof as numba_type  # noqa: E402, F401
from numba import types  # noqa: E402, F401  (kernel files take their type names from here)
from numba.core import codegen  # noqa: E402


def _keep_copies_apart() -> None:
    """Give each compiled function copies of its own of what it calls.

    Numba links callees into their callers under names that any loaded library may define, and the process then takes
    whichever came first. What was compiled or loaded before would so decide about the last bits of a result: a first
    run, which compiles the callees too, and a later one, which loads the callers alone, would differ. With internal
    linkage they cannot; for linking into further callers Numba is left the copies as it knows them.
    """
    original = codegen.JITCodeLibrary._finalize_final_module

    def finalize(library):  # type: ignore[no-untyped-def]
        if library._shared_module is not None:  # loaded from the cache: it is as it was compiled
            return original(library)
        shared = library._final_module.clone()
        for function in shared.functions:
            if not function.is_declaration and function.linkage == llvmlite.binding.Linkage.external:
                function.linkage = "linkonce_odr"
        library._shared_module = shared
        for function in library._final_module.functions:
            if not function.is_declaration and function.linkage == llvmlite.binding.Linkage.linkonce_odr:
                function.linkage = "internal"
        return original(library)

    codegen.JITCodeLibrary._finalize_final_module = finalize  # type: ignore[method-assign]  # there is no other door


_keep_copies_apart()

#: Reassociation and contraction give the full speed; nnan and ninf stay out, so that isfinite keeps its meaning.
_FASTMATH = {"reassoc", "contract", "nsz", "arcp"}
_FLAGS: dict[str, Any] = {"cache": True, "nogil": True, "fastmath": _FASTMATH, "error_model": "numpy"}


#: What a kernel that makes arrays of its own calls.
_ALLOCATORS = {"zeros", "empty", "ones"}


def _compile(function: Callable, **flags: Any) -> Any:
    """A dispatcher whose cache is that of its module's room.

    Unless it makes arrays of its own it counts no references: each row of an array would cost two locked additions, and
    whoever calls a kernel holds its arrays anyway.
    """
    flags["_nrt"] = bool(_ALLOCATORS & set(function.__code__.co_names))
    room = function.__module__.removeprefix("brdffit.").partition(".")[0]
    group = room if room in _KERNEL_ROOMS else "fitting"
    foreign = _foreign_sources(function)
    folder = CACHE_FOLDERS[group] + (f"-{_digest_of(foreign)}" if foreign else "")
    numba.config.CACHE_DIR = folder  # type: ignore[attr-defined]  # Numba reads it at decoration
    return numba.njit(**flags)(function)


#: Modules whose functions Numba compiles in ways of its own: a version of the machine's, not a source of the user's.
_NOT_FOLLOWED = {*sys.stdlib_module_names, "numpy", "numba", "scipy", "llvmlite"}


def _foreign_sources(function: Callable) -> frozenset[str]:
    """What a kernel stands on that is no part of brdffit: files of the functions it calls, and values that those read.

    Functions are followed through the globals that they name, attributes of modules included.
    """
    own = str(Path(__file__).parent) + os.sep
    found: set[str] = set()
    seen: set[int] = set()
    waiting: list[Any] = [function]
    while waiting:
        each = waiting.pop()
        each = getattr(each, "py_func", each)
        if id(each) in seen or not isinstance(each, python_types.FunctionType):
            continue
        seen.add(id(each))
        source = each.__code__.co_filename
        foreign = not source.startswith(own)
        if foreign:
            found.add(f"file {source}")
        for name in each.__code__.co_names:
            value = each.__globals__.get(name)
            if isinstance(value, python_types.ModuleType):
                if foreign and value.__name__.partition(".")[0] not in _NOT_FOLLOWED:
                    waiting += [getattr(value, other, None) for other in each.__code__.co_names]
            elif hasattr(value, "py_func") or (foreign and isinstance(value, python_types.FunctionType)):
                waiting.append(value)
            elif foreign and isinstance(value, (bool, int, float, complex, str, tuple)):
                found.add(f"value {name} {value!r}")
        closed = [cell.cell_contents for cell in each.__closure__ or ()] if foreign else []
        waiting += closed
        found |= {f"value {value!r}" for value in closed if isinstance(value, (bool, int, float, complex, str, tuple))}
    return frozenset(found)


@cache
def _digest_of(sources: frozenset[str]) -> str:
    digest = hashlib.sha256()
    for source in sorted(sources):
        kind, _, rest = source.partition(" ")
        path = Path(rest)
        digest.update(source.encode())
        if kind == "file" and path.is_file():
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def kernel(function: Callable) -> Any:
    """Compile on first call; releases the GIL; cached on disk."""
    return _compile(function, **_FLAGS)


def inline(function: Callable) -> Any:
    """Scalar maths that is inlined into the loops that call it."""
    return _compile(function, forceinline=True, **_FLAGS)


def part(function: Callable) -> Any:
    """A piece of one longer kernel: put into its caller before anything is optimised.

    LLVM optimises a kernel by itself and again within each of its callers, so that a chain of calls compiles its end
    as often as it is long.
    """
    return _compile(function, inline="always", **_FLAGS)


def specialise(template: Any, suffix: str, **bindings: Any) -> Any:
    """A kernel with the code of ``template`` and some of its global names bound anew: one loop, many models.

    Kernels that the template calls and that use a bound name themselves are specialised along. A closure would never
    reach the disk cache; a function of its own, with a name of its own, does.
    """
    source = template.py_func
    names = set(source.__code__.co_names)
    new_globals = dict(source.__globals__)
    # What is bound may itself use a bound name (the float type): specialised along.
    own = {name: value for name, value in bindings.items() if value is not source.__globals__.get(name)}
    for name, value in bindings.items():
        if isinstance(value, numba.core.dispatcher.Dispatcher):
            rest = {other: bound for other, bound in own.items() if other != name}
            bindings[name] = specialise(value, suffix, **rest) if rest and _uses(value, rest.keys()) else value
    new_globals.update(bindings)
    for name in names - bindings.keys():
        callee = new_globals.get(name)
        if isinstance(callee, numba.core.dispatcher.Dispatcher) and _uses(callee, bindings.keys()):
            new_globals[name] = specialise(callee, suffix, **bindings)
    copy = python_types.FunctionType(source.__code__, new_globals, source.__name__ + suffix, source.__defaults__)
    copy.__qualname__ = source.__qualname__ + suffix
    copy.__module__ = source.__module__
    flags = dict(_FLAGS)
    for option in ("forceinline", "inline"):
        if template.targetoptions.get(option):
            flags[option] = template.targetoptions[option]
    return _compile(copy, **flags)


def _uses(callee: Any, names: Any) -> bool:
    """Whether a kernel, or one it calls, refers to one of these global names."""
    function = callee.py_func
    if set(function.__code__.co_names) & set(names):
        return True
    called = (function.__globals__.get(name) for name in function.__code__.co_names)
    return any(_uses(other, names) for other in called if isinstance(other, numba.core.dispatcher.Dispatcher))
