"""All compilation by Numba: its flags, the folders of its cache, and kernels compiled once for each lobe model.

Numba checks only the file of a cached kernel, not the files of the functions that it calls, and so would go on using an
old version of an edited function. Therefore each cache folder is named after the hash of all sources that its kernels
may use: after an edit the name is another, and the kernels are compiled again. A lobe that a user wrote is compiled
into our kernels; their folder is named after the user's sources as well.
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

#: For each folder with kernels, all folders whose kernels it may call, itself included.
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
    """Folder below ``base`` for a group's compiled kernels, named after the hash of all sources that they may use."""
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


#: Where the compiled kernels of each group are.
CACHE_FOLDERS = {group: _cache_folder(group, _cache_root()) for group in _KERNEL_ROOMS}
# Before Numba is imported: it reads its environment variables then.
_use_wide_vectors()

import numba  # noqa: E402
from numba import typeof as numba_type  # noqa: E402, F401
from numba import types  # noqa: E402  (kernel files take their type names from here)
from numba.core import codegen  # noqa: E402


def _keep_copies_apart() -> None:
    """Make the last bits of a result independent of which other kernels are loaded.

    Numba copies the functions that a kernel calls into the kernel's library, optimised with it. But it exports these
    copies, and if two libraries export the same name, the process uses the copy that was loaded first, also from the
    other library. The copies may round differently. So a first run, which compiles the called functions too, and a
    later run, which loads the kernel alone, would differ in last bits. Here each library's copies become internal, so
    that it uses its own. Kernels that are compiled later link to ``_shared_module``, which still exports them.
    """
    original = codegen.JITCodeLibrary._finalize_final_module

    def finalize(library):  # type: ignore[no-untyped-def]
        if library._shared_module is not None:  # loaded from the cache, where it was changed before
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

    codegen.JITCodeLibrary._finalize_final_module = finalize  # type: ignore[method-assign]  # Numba has no option for it


_keep_copies_apart()

#: Sums may be reordered and products fused. Not "nnan" and "ninf", with which isfinite would always be true.
_FASTMATH = {"reassoc", "contract", "nsz", "arcp"}
_FLAGS: dict[str, Any] = {"cache": True, "nogil": True, "fastmath": _FASTMATH, "error_model": "numpy"}


#: Functions that allocate arrays.
_ALLOCATORS = {"zeros", "empty", "ones"}


def _compile(function: Callable, **flags: Any) -> Any:
    """Compile a function on its first call; its cache is in the folder of its group.

    Reference counts are left out unless the function allocates arrays. They would cost two atomic additions for each
    row that is taken of an array, and a kernel's arrays are kept alive by its caller anyway. But a caller that counts
    gives up one reference to an array that it is handed back, and frees it too early if none was added: what returns
    arrays has to be a ``part``, which becomes the caller's own code, or the compilation fails.
    """
    flags["_nrt"] = bool(_ALLOCATORS & set(function.__code__.co_names))
    room = function.__module__.removeprefix("brdffit.").partition(".")[0]
    group = room if room in _KERNEL_ROOMS else "fitting"
    foreign = _foreign_sources(function)
    folder = CACHE_FOLDERS[group] + (f"-{_digest_of(foreign)}" if foreign else "")
    numba.config.CACHE_DIR = folder  # type: ignore[attr-defined]  # Numba reads it at decoration
    compiled = numba.njit(**flags)(function)
    if not flags["_nrt"] and flags.get("inline") != "always":
        add = compiled.add_overload

        def checked(result: Any) -> Any:
            if _holds_array(result.signature.return_type):
                raise TypeError(f"{function.__qualname__} returns an array without counting it: make it a part")
            return add(result)

        compiled.add_overload = checked
    return compiled


def _holds_array(kind: Any) -> bool:
    # Numba itself refuses to return plain arrays uncounted, but not tuples of them.
    if isinstance(kind, types.BaseTuple):
        inside: Any = kind
        return any(_holds_array(each) for each in inside)
    return isinstance(kind, types.Array)


#: Modules that are not searched for sources of a user's lobe: Python's own, and those whose functions Numba replaces.
_NOT_FOLLOWED = {*sys.stdlib_module_names, "numpy", "numba", "scipy", "llvmlite"}


def _foreign_sources(function: Callable) -> frozenset[str]:
    """Everything outside of brdffit that a kernel's code depends on: as "file PATH" and "value NAME VALUE".

    Files are those of the functions that it calls, directly or not; values are the constants that these functions read.
    Functions are found by the global names that they use, also as attributes of modules.
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
    """Compile scalar maths, which LLVM inlines into the loops that call it."""
    return _compile(function, forceinline=True, **_FLAGS)


def part(function: Callable) -> Any:
    """Compile a part of a longer kernel, inlined before anything is optimised.

    This saves time: LLVM optimises other kernels by themselves and again in each kernel that calls them, so that the
    last of a chain of five calls would be optimised five times.
    """
    return _compile(function, inline="always", **_FLAGS)


def specialise(template: Any, suffix: str, **bindings: Any) -> Any:
    """A copy of the kernel ``template`` in which some global names have other values: one loop for many lobe models.

    Kernels that the template calls are copied likewise if they use one of these names, directly or not. Closures would
    be simpler, but Numba's disk cache does not take them; it takes functions with names of their own.

    Args:
        template: a compiled kernel.
        suffix: is added to the name of each copy.
        bindings: values by global name.
    """
    source = template.py_func
    names = set(source.__code__.co_names)
    new_globals = dict(source.__globals__)
    # A value that is a kernel may itself use another of the names (the float type); then it is copied, too.
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
