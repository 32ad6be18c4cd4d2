#!/bin/sh
# Prints a Python 3.11, 3.12 or 3.13 that can make the environment: $PYTHON if set,
# else the first of python3.13, python3.12, python3.11, python3 and ~/.pyenv/versions.
# Says in one line what is missing, and how to get it, when there is none.

check='
import sys, sysconfig, os, importlib.util as u
if not (3, 11) <= sys.version_info[:2] <= (3, 13):
    print("is Python %d.%d, not 3.11, 3.12 or 3.13" % sys.version_info[:2])
elif u.find_spec("venv") is None or u.find_spec("ensurepip") is None:
    print("lacks venv; install python3-venv (Debian, Ubuntu: apt-get install python%d.%d-venv)" % sys.version_info[:2])
elif not os.path.exists(os.path.join(sysconfig.get_paths()["include"], "Python.h")):
    print("lacks its headers; install them (Debian, Ubuntu: apt-get install python%d.%d-dev)" % sys.version_info[:2])
else:
    print("ok")
'

if [ -n "$PYTHON" ]; then
    path=$(command -v "$PYTHON") || { echo "setup: PYTHON=$PYTHON is not a program" >&2; exit 1; }
    why=$("$path" -c "$check" 2>/dev/null) || why="does not run"
    [ "$why" = ok ] || { echo "setup: $path $why" >&2; exit 1; }
    echo "$path"
    exit 0
fi

reason=
for name in python3.13 python3.12 python3.11 python3 \
    "$HOME"/.pyenv/versions/3.13.*/bin/python \
    "$HOME"/.pyenv/versions/3.12.*/bin/python \
    "$HOME"/.pyenv/versions/3.11.*/bin/python; do
    path=$(command -v "$name") || continue
    # A version manager's shim exists for versions that are not switched on: it does not run.
    why=$("$path" -c "$check" 2>/dev/null) || continue
    if [ "$why" = ok ]; then
        echo "$path"
        exit 0
    fi
    [ -n "$reason" ] || reason="; $path $why"
done
echo "setup: no usable Python 3.11, 3.12 or 3.13 found (or name one: make PYTHON=/path/to/python3.12)$reason" >&2
exit 1
