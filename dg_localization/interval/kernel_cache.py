# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The folder in which compiled kernels are kept between processes.

It is ``dg_localization/<digest>`` in ``$NUMBA_CACHE_DIR``, else in ``$XDG_CACHE_HOME``, else in
``~/.cache``. Numba keeps compiled functions too, but dates each by the file that it is written in:
an edited comment compiles anew, and an edited kernel does not recompile its callers, although it
was compiled into them. Here the digest is that of the code of all kernels, without comments and
docstrings, and of the versions of Python, numba, llvmlite and NumPy.

What is loaded from the folder is run. So nobody but the user may be able to write to it; another
folder is refused, and nothing is kept. An entry that cannot be read is compiled anew. Several
processes may use one folder: each holds its lock ``in_use`` in common as long as it lives, which
keeps the folder from being pruned, and the lock ``writing`` alone while it adds an entry.

`numba_cache` does this with private parts of numba. Where they are gone, numba's own cache is
used, in the folder of the digest.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
import hashlib
from importlib.metadata import PackageNotFoundError, version
import os
from pathlib import Path
import platform
import re
import shutil
import stat
from typing import Any

try:
    import fcntl
except ImportError:  # not a POSIX system
    fcntl = None  # type: ignore[assignment]

PACKAGE = Path(__file__).parents[1]
DECORATOR = Path(__file__).with_name('kernels.py')
DECORATOR_NAME = 'dg_localization.interval.kernels'
KEEPING = {Path(__file__), Path(__file__).with_name('numba_cache.py')}

KEPT_FOLDERS = 8
"""So many folders, the one in use included, are kept for other states of the sources."""

DIGEST = re.compile(r'[0-9a-f]{16}\Z')

Keeper = Callable[[Any, Callable[..., Any]], None]
"""Makes a dispatcher of numba keep what it compiles of a function."""


class CacheRefusedError(Exception):
    """Compiled kernels cannot be kept, or must not be loaded; the text says why."""


def open_folder() -> Path:
    """
    Return the folder for kernels compiled from exactly this code; make it where it is missing.

    A new one takes the place of the oldest that no process uses, if there are many.

    Raises
    ------
    CacheRefusedError
        If there can be no such folder, or if others may write to it.

    """
    try:
        root = _root()
        folder = root / _digest()
        is_new = not folder.exists()
        make_private(folder)
        _check_ownership(folder)
        if fcntl is not None:
            _hold(folder / 'in_use')
    except (OSError, RuntimeError, SyntaxError) as error:
        raise CacheRefusedError(f'compiled kernels cannot be kept: {error}') from error
    if is_new and fcntl is not None:
        _prune(root, folder)
    return folder


def _root() -> Path:
    """Return where the folders of all states of the sources are."""
    base = os.environ.get('NUMBA_CACHE_DIR') or os.environ.get('XDG_CACHE_HOME')
    return (Path(base) if base else Path.home() / '.cache').resolve() / 'dg_localization'


def make_private(folder: Path) -> None:
    """Make a folder and those above it; what is made belongs to the user alone."""
    for place in (*reversed(folder.parents), folder):
        with suppress(FileExistsError):
            place.mkdir(mode=0o700)


def _check_ownership(folder: Path) -> None:
    """Raise `CacheRefusedError` if another user could have put something into a folder."""
    if not hasattr(os, 'geteuid'):
        return
    # Whoever owns the root of the file system, in a container perhaps not 0, owns the machine.
    trusted = {os.geteuid(), 0, Path('/').stat().st_uid}
    for place in (folder, *folder.parents):
        found = place.stat()
        ours = place in (folder, folder.parent)
        if found.st_uid not in ({os.geteuid()} if ours else trusted):
            raise CacheRefusedError(
                f'compiled kernels are not kept: {place} belongs to user {found.st_uid}, not to '
                f'{os.geteuid()}, and what is loaded from there is run; set NUMBA_CACHE_DIR to a '
                'folder of your own'
            )
        # In a sticky folder such as /tmp others can add files, not replace those of the user.
        sticky = not ours and found.st_mode & stat.S_ISVTX
        if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH) and not sticky:
            raise CacheRefusedError(
                f'compiled kernels are not kept: others may write to {place}, and what is loaded '
                f'from there is run; empty it if others did, then `chmod go-w {place}`'
            )


def _hold(lock: Path) -> None:
    """Hold a lock in common with other processes for the life of this one."""
    while True:
        descriptor = _open_lock(lock)
        fcntl.flock(descriptor, fcntl.LOCK_SH)
        # Whoever pruned the folder may have removed the file before it was locked.
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(descriptor), lock.stat()):
                break
        os.close(descriptor)
        make_private(lock.parent)
    # `_prune` asks when a folder was last used.
    with suppress(OSError):
        os.utime(lock)


def _open_lock(lock: Path) -> int:
    """Open a lock; one on a read-only file system only has to exist."""
    try:
        return os.open(lock, os.O_RDWR | os.O_CREAT, 0o600)
    except OSError:
        return os.open(lock, os.O_RDONLY)


@contextmanager
def alone(lock: Path, wait: bool = True) -> Iterator[None]:
    """Hold a lock alone; raise `BlockingIOError` where it is taken and we do not `wait`."""
    descriptor = _open_lock(lock)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        yield
    finally:
        os.close(descriptor)


def _prune(root: Path, in_use: Path) -> None:
    """Remove the folders that were not used for longest and are not in use."""
    others = [path for path in root.iterdir() if DIGEST.match(path.name) and path != in_use]
    for folder in sorted(others, key=_last_used_s, reverse=True)[KEPT_FOLDERS - 1 :]:
        # Taken, or not ours to remove: it stays.
        with suppress(OSError), alone(folder / 'in_use', wait=False):
            shutil.rmtree(folder, ignore_errors=True)


def _last_used_s(folder: Path) -> float:
    """Return when a process last opened a folder, 0 where nobody knows."""
    for path in (folder / 'in_use', folder):
        with suppress(OSError):
            return path.stat().st_mtime
    return 0.0


def _digest() -> str:
    """Return the name of the folder: a digest of all that a compiled kernel depends on."""
    digest = hashlib.sha256(repr((platform.python_implementation(), _versions())).encode())
    for path, code in sorted(_kernel_code().items()):
        digest.update(str(path.relative_to(PACKAGE)).encode())
        digest.update(code)
    return digest.hexdigest()[:16]


def _versions() -> list[str]:
    """Return the versions of what compiles the kernels, and of what they are compiled for."""
    versions = [platform.python_version()]
    for name in ('numba', 'llvmlite', 'numpy'):
        try:
            versions.append(version(name))
        except PackageNotFoundError:
            versions.append('')
    return versions


def _kernel_code() -> dict[Path, bytes]:
    """
    Return the digests of the sources that hold kernels, and of those that these import.

    A kernel may use a constant of any module that its own imports.
    """
    # How kernels are kept has no part in what they are.
    sources = set(PACKAGE.rglob('*.py')) - KEEPING
    if DECORATOR not in sources:
        raise OSError(f'the sources in {PACKAGE} cannot be read')
    candidates = [path for path in sources if DECORATOR_NAME.encode() in path.read_bytes()]
    read = {path: read_code(path) for path in (*candidates, DECORATOR)}
    waiting = [path for path, (_, names) in read.items() if f'{DECORATOR_NAME}.kernel' in names]
    waiting.append(DECORATOR)
    found: dict[Path, bytes] = {}
    while waiting:
        path = waiting.pop()
        if path not in found:
            found[path], names = read.get(path) or read_code(path)
            waiting.extend(_files_of(names) & sources)
    return found


def read_code(path: Path) -> tuple[bytes, set[str]]:
    """
    Return a digest of a source and the names of the modules that it may import.

    Comments, docstrings and layout do not change the digest.
    """
    tree = ast.parse(path.read_bytes())
    names: set[str] = set()
    for node in ast.walk(tree):
        statements = getattr(node, 'body', None)
        if isinstance(statements, list):
            node.body = [one for one in statements if not _is_text(one)]  # type: ignore[attr-defined]
        elif isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module)
            names.update(f'{node.module}.{alias.name}' for alias in node.names)
    return hashlib.sha256(ast.dump(tree).encode()).digest(), names


def _is_text(statement: ast.stmt) -> bool:
    """Return whether a statement is a docstring, or another constant that does nothing."""
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)


def _files_of(names: set[str]) -> set[Path]:
    """Return where modules would be if they were of this package."""
    places = [PACKAGE.parent.joinpath(*name.split('.')) for name in names]
    return {place.with_name(f'{place.name}.py') for place in places} | {
        place / '__init__.py' for place in places
    }
