#!/bin/sh
# Make the virtual environment of this package.
#
# Wheels are kept in a folder inside pip's cache and are tried first, so that another clone on the
# same machine needs no network. (pip's own HTTP cache cannot do that: it asks for the package
# index again each time.)
#
# Environment: PYTHON (default python3), VENV (default .venv).
set -eu

python=${PYTHON:-python3}
venv=${VENV:-.venv}

fail() {
    printf '%s\n' "$@" >&2
    exit 1
}

command -v "$python" >/dev/null 2>&1 || fail "PYTHON=$python: not found; install python3 and python3-venv."
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
    fail "PYTHON=$python is $("$python" -V); this package needs Python 3.11 or newer."

# Where Jazzy is sourced its own packages are used; elsewhere they come as wheels.
extras='bags plots progress speed test lint bench'
case ${ROS_DISTRO:-} in
jazzy)
    "$python" -c 'import rclpy' 2>/dev/null ||
        fail "ROS 2 Jazzy is sourced, but $python ($("$python" -V)) cannot import rclpy." \
            "Use the Python that it was built for (PYTHON=/usr/bin/python3) or a shell without ROS."
    mode=jazzy
    system_site_packages=true
    ;;
'')
    mode=wheels
    system_site_packages=false
    extras="ros $extras"
    ;;
*)
    fail "ROS_DISTRO=$ROS_DISTRO is sourced; this package is for jazzy." \
        "Use a shell where ROS 2 Jazzy, or no ROS at all, is sourced."
    ;;
esac

# A folder that was made for the other mode or by another Python is made anew.
version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
if [ -e "$venv" ] && {
    ! grep -q "include-system-site-packages = $system_site_packages" "$venv/pyvenv.cfg" ||
        ! "$venv/bin/python" -c "import sys; sys.exit('%d.%d' % sys.version_info[:2] != '$version')"
}; then
    [ -f "$venv/pyvenv.cfg" ] || fail "VENV=$venv exists and is no virtual environment."
    rm -rf "$venv"
fi
if ! [ -x "$venv/bin/pip" ]; then
    printf 'Making %s with Python %s (ROS 2: %s)\n' "$venv" "$version" "$mode"
    site_option=
    [ $mode = wheels ] || site_option=--system-site-packages
    "$python" -m venv $site_option "$venv" ||
        fail "$python -m venv failed; on Debian and Ubuntu: apt install python3-venv"
fi

pip() {
    PIP_DISABLE_PIP_VERSION_CHECK=1 "$venv/bin/python" -m pip "$@"
}

cache=$(pip cache dir 2>/dev/null) || cache=${XDG_CACHE_HOME:-$HOME/.cache}/pip
wheels=$cache/dg_localization/$mode-$version
mkdir -p "$wheels"

# The sourced ROS was compiled against the system's numpy: no newer one may hide it.
constraints=$venv/constraints.txt
: >"$constraints"
if [ $mode = jazzy ]; then
    "$python" -c 'import numpy; print("numpy==" + numpy.__version__)' >"$constraints"
fi

# Install requirements from the folder of wheels, after filling it if it lacks any.
install() {
    if ! pip install --quiet --no-index --find-links "$wheels" "$@" 2>/dev/null; then
        printf 'Fetching packages into %s\n' "$wheels"
        pip wheel --wheel-dir "$wheels" --find-links "$wheels" "$@" ||
            fail 'Packages could not be fetched: the first set-up needs the network.'
        printf 'Installing them\n'
        pip install --quiet --no-index --find-links "$wheels" "$@"
    fi
}

install setuptools wheel
pip install --quiet --no-deps --no-build-isolation --editable .
"$venv/bin/python" - $extras >"$venv/requirements.txt" <<'END'
from importlib.metadata import requires
import sys

from pip._vendor.packaging.requirements import Requirement

for requirement in map(Requirement, requires('dg_localization')):
    marker = requirement.marker
    if marker is None or any(marker.evaluate({'extra': extra}) for extra in sys.argv[1:]):
        requirement.marker = None
        print(requirement)
END
install -r "$venv/requirements.txt" -c "$constraints"
printf 'Ready: %s\n' "$venv"
