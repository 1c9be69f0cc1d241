# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The folder in which numba keeps compiled kernels between processes.

It is ``dg_localization/<digest>`` in ``$NUMBA_CACHE_DIR``, else in ``$XDG_CACHE_HOME``, else in
``~/.cache``. Numba recompiles a function if its own file changes, but not if a function or
constant from another file changes that was compiled into it. So the digest covers the sources of
all kernels and of their imports, and the versions of Python, numba and NumPy.

Code loaded from the folder is executed, so a folder that another user could write to is refused.
"""

from __future__ import annotations

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
try:
    from numba import config
    from numba.core.caching import FunctionCache
except Exception:  # no numba, or one that cannot be imported here; `kernels` says which
    FunctionCache = object

PACKAGE = Path(__file__).parents[1]
IMPORT = re.compile(r'^from (dg_localization[\w.]*) import (?:\(([^)]*)\)|(.*))', re.MULTILINE)
KEPT_FOLDERS = 8
"""Number of folders, one for each state of the sources, that are kept."""


class CacheRefusedError(Exception):
    """Compiled kernels cannot be kept, or must not be loaded; the text says why."""


def open_folder() -> Path:
    """Return the folder for these sources, made if missing; raise `CacheRefusedError`."""
    try:
        base = os.environ.get('NUMBA_CACHE_DIR') or os.environ.get('XDG_CACHE_HOME')
        root = (Path(base) if base else Path.home() / '.cache').resolve() / 'dg_localization'
        folder = root / _digest()
        for place in (*reversed(folder.parents), folder):
            place.mkdir(mode=0o700, exist_ok=True)
        _check_ownership(folder)
        os.utime(folder)
    except (OSError, RuntimeError) as error:
        raise CacheRefusedError(f'compiled kernels cannot be kept: {error}') from error
    old = [place for place in root.iterdir() if re.fullmatch('[0-9a-f]{16}', place.name)]
    for place in sorted(old, key=lambda place: place.stat().st_mtime)[:-KEPT_FOLDERS]:
        shutil.rmtree(place, ignore_errors=True)
    return folder


def _check_ownership(folder: Path) -> None:
    """Raise `CacheRefusedError` if another user could have written to a folder."""
    if not hasattr(os, 'geteuid'):
        return
    # The owner of the root of the file system, not always 0 in a container, is trusted.
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
        # In a sticky folder such as /tmp others can add files, but not replace files of the user.
        sticky = not ours and found.st_mode & stat.S_ISVTX
        if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH) and not sticky:
            raise CacheRefusedError(
                f'compiled kernels are not kept: others may write to {place}, and what is loaded '
                f'from there is run; empty it if others did, then `chmod go-w {place}`'
            )


def _digest() -> str:
    """Return the digest of everything that a compiled kernel depends on."""
    digest = hashlib.sha256(
        f'{platform.python_implementation()} {platform.python_version()}'.encode()
    )
    for name in ('numba', 'llvmlite', 'numpy'):
        try:
            digest.update(version(name).encode())
        except PackageNotFoundError:
            digest.update(b'none')
    for path, text in sorted(kernel_sources().items()):
        digest.update(f'{path.relative_to(PACKAGE)}\n{text}'.encode())
    return digest.hexdigest()[:16]


def kernel_sources() -> dict[Path, str]:
    """Return the sources that hold kernels, and the sources that these import."""
    sources = {path: path.read_text(encoding='utf-8') for path in PACKAGE.rglob('*.py')}
    imports = {
        path: [(module, re.findall(r'\w+', names + more)) for module, names, more in found]
        for path, found in ((path, IMPORT.findall(text)) for path, text in sources.items())
    }
    waiting = [
        path
        for path, found in imports.items()
        if any(
            module.endswith('interval.kernels') and 'kernel' in names for module, names in found
        )
    ]
    if not waiting:
        raise OSError(f'the sources in {PACKAGE} cannot be read')
    reached: dict[Path, str] = {}
    while waiting:
        path = waiting.pop()
        if path in sources and path not in reached:
            reached[path] = sources[path]
            for module, names in imports[path]:
                place = PACKAGE.parent.joinpath(*module.split('.'))
                for named in (place, *(place / name for name in names)):
                    waiting += [named.with_name(f'{named.name}.py'), named / '__init__.py']
    return reached


class KernelCache(FunctionCache):
    """Numba's cache of one function; a damaged or missing entry only costs time."""

    def __init__(
        self, function: Callable[..., Any], folder: Path, not_kept: Callable[[OSError], None]
    ) -> None:
        self._folder, self._not_kept = folder, not_kept
        previous, config.CACHE_DIR = config.CACHE_DIR, str(folder)
        try:
            super().__init__(function)
        finally:
            config.CACHE_DIR = previous
        if not Path(self.cache_path).is_relative_to(folder):
            raise OSError('numba keeps machine code where no digest dates it')

    def load_overload(self, *args: Any) -> Any:
        """Return stored machine code; None if there is none or it is damaged."""
        try:
            return super().load_overload(*args)
        except Exception:  # unpickling damaged data raises almost anything
            with suppress(OSError), self._alone():
                self.flush()
            return None

    def save_overload(self, *args: Any) -> None:
        """Store machine code."""
        # Numba reads the index, adds to it and writes it. Two processes at once could use one name
        # for the machine code of two signatures.
        try:
            # Under load numba sometimes has no machine code to write and raises RuntimeError.
            with self._alone(), suppress(RuntimeError):
                super().save_overload(*args)
        except OSError as error:
            self._not_kept(error)

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """Hold the lock of the folder."""
        with open(self._folder / 'lock', 'w') as lock:
            if fcntl is not None:
                fcntl.flock(lock, fcntl.LOCK_EX)
            yield
