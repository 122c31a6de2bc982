"""Exported C, compiled under the strictest options and run under sanitizers."""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

STRICT = (
    "-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-Wshadow",
)  # fmt: skip
CHECKED = ("-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")

DRIVER = """
#include "NAME.h"
#include <stdio.h>

/* Reads parameters, the first input, and then inputs and states by turns; writes the
 * first state and output, and what a step makes of each state. A state that is not a
 * number at its first element is the one of before. */
static int get(void *to, size_t size) { return fread(to, size, 1, stdin) == 1; }
static void put(const void *of, size_t size) { fwrite(of, size, 1, stdout); }

int main(void)
{
    NAME_parameters parameters;
    NAME_constants constants;
    NAME_state state, given;
    NAME_output out;
    NAME_input in;
    double ticks;

    while (get(&parameters, sizeof parameters) && get(&ticks, sizeof ticks)) {
        int first = 1;
        NAME_prepare(&constants, &parameters);
        for (; ticks > 0.0; ticks -= 1.0, first = 0) {
            double own;
            if (!get(&in, sizeof in)) return 1;
            if (first) {
                NAME_start(&state, &out, &constants, &in);
                put(&state, sizeof state);
                put(&out, sizeof out);
            }
            if (!get(&own, sizeof own) || !get(&given, sizeof given)) return 1;
            if (own > 0.0) state = given;
            NAME_step(&state, &out, &constants, &in);
            put(&state, sizeof state);
            put(&out, sizeof out);
        }
    }
    return 0;
}
"""


def compiler() -> str:
    """A C compiler, or the test is skipped."""
    cc = shutil.which("gcc") or shutil.which("clang") or shutil.which("cc")
    if cc is None:
        pytest.skip("no C compiler on this machine")
    return cc


class Native:
    """A machine's two files as a program that steps it; all its numbers are double.

    `parameters`, `state`, `inputs` and `outputs` are the fields' names in order, an
    array's element as `name[i]`.
    """

    def __init__(self, name: str, files: dict[str, str], folder: Path):
        self.header, self.source = files[f"{name}.h"], files[f"{name}.c"]
        for file, text in files.items():
            (folder / file).write_text(text)
        (folder / "driver.c").write_text(DRIVER.replace("NAME", name))
        self.program = folder / f"{name}_driver"
        sources = [folder / f"{name}.c", folder / "driver.c"]
        subprocess.run(
            [compiler(), *STRICT, *CHECKED, *sources, "-lm", "-o", self.program],
            check=True,
        )
        self.parameters, self.state, self.inputs, self.outputs = (
            self._fields(f"{name}_{kind}")
            for kind in ("parameters", "state", "input", "output")
        )

    def _fields(self, struct: str) -> list[str]:
        pattern = r"typedef struct \{([^}]*)\} " + struct + ";"
        body = re.search(pattern, self.header).group(1)
        out = []
        for name, size in re.findall(r"double (\w+)(?:\[(\d+)\])?;", body):
            out += [f"{name}[{i}]" for i in range(int(size))] if size else [name]
        return out

    def run(self, parameters, inputs, states=None):
        """Start, and one step by inputs [N, .], from states [N, .] or its own.

        Returns states and outputs [N + 1, .], those of the start first.
        """
        n, size = len(inputs), len(self.state)
        own = np.zeros((n, size)) if states is None else states
        flags = np.full((n, 1), 0.0 if states is None else 1.0)
        rows = np.hstack([inputs, flags, own])
        given = np.concatenate([parameters, [float(n)], rows.ravel()])
        done = subprocess.run(
            [self.program], input=given.astype(float).tobytes(), capture_output=True,
            check=True,
        )  # fmt: skip
        table = np.frombuffer(done.stdout).reshape(n + 1, -1)
        return table[:, :size], table[:, size:]
