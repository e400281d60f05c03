"""What each consumer does with the text, by its own documentation: parse, then correct.

Every function returns a correction of fields in tesla in the consumer's own axes.
"""

from __future__ import annotations

import re
import shutil
import subprocess

import numpy as np
import yaml

GAUSS_IN_TESLA = 1e-4
MILLIGAUSS_IN_TESLA = 1e-7
FLIP = np.array([1.0, -1.0, -1.0])


def ros_parameters(text):
    return yaml.safe_load(text)["/**"]["ros__parameters"]


def matrix_of(values):
    assert len(values) == 9
    assert all(isinstance(value, float) for value in values)
    return np.array(values).reshape(3, 3)


def ctu_vras(text, matrix_name="initial_mag_scaling_matrix"):
    given = ros_parameters(text)
    bias = np.array([given[f"initial_mag_bias_{axis}"] for axis in "xyz"])
    scale = matrix_of(given[matrix_name])
    return lambda mag: (mag - bias) @ scale.T


def madgwick(text):
    given = ros_parameters(text)
    bias = np.array([given[f"mag_bias_{axis}"] for axis in "xyz"])
    return lambda mag: mag - bias


def fusioncore(text):
    given = ros_parameters(text)
    soft, hard = matrix_of(given["magnetometer.soft_iron"]), given["magnetometer.hard_iron"]
    return lambda mag: (mag - np.array(hard)) @ soft.T


def symmetric(diagonal, off):
    (a, b, c), (d, e, f) = diagonal, off
    return np.array([[a, d, e], [d, b, f], [e, f, c]])


def ardupilot(text):
    lines = [line.split(",") for line in text.splitlines() if not line.startswith("#")]
    given = {name: float(value) for name, value in lines}
    three = {k: [given[f"COMPASS_{k}_{axis}"] for axis in "XYZ"] for k in ("OFS", "DIA", "ODI")}
    matrix = symmetric(three["DIA"], three["ODI"])

    def correct(mag):
        milligauss = mag / MILLIGAUSS_IN_TESLA + three["OFS"]
        return MILLIGAUSS_IN_TESLA * given["COMPASS_SCALE"] * milligauss @ matrix.T

    return correct


def px4(text):
    given = {}
    for line in text.splitlines():
        if not line.startswith("#"):
            command, kind, name, value = line.split(" ")
            assert (command, kind) == ("param", "set")
            given[name] = float(value)
    three = {k: [given[f"CAL_MAG0_{axis}{k}"] for axis in "XYZ"] for k in ("OFF", "SCALE", "ODIAG")}
    matrix = symmetric(three["SCALE"], three["ODIAG"])
    return lambda mag: GAUSS_IN_TESLA * (mag / GAUSS_IN_TESLA - three["OFF"]) @ matrix.T


def vectornav(text):
    body, given = re.fullmatch(r"\$(VNWRG,23,[-0-9.,]+)\*([0-9A-F]{2})\n", text).groups()
    checksum = 0
    for byte in body.encode():
        checksum ^= byte
    assert int(given, 16) == checksum
    twelve = np.array([float(word) for word in body.split(",")[2:]])
    matrix, bias = twelve[:9].reshape(3, 3), twelve[9:]
    return lambda mag: GAUSS_IN_TESLA * (mag / GAUSS_IN_TESLA - bias) @ matrix.T


def c_header(text, folder):
    """Compile the header, included twice, if there is a compiler; else parse its text."""
    compiler = shutil.which("cc")
    if compiler is None:
        code = re.sub(r"/\*.*?\*/", "", text, flags=re.S)
        found = re.findall(r"[-+]?\d+\.\d*(?:e[-+]?\d+)?", code)
        twelve = np.array([float(word) for word in found])
    else:
        (folder / "calibration.h").write_text(text)
        (folder / "main.c").write_text(
            '#include <stdio.h>\n#include "calibration.h"\n#include "calibration.h"\n'
            "int main(void) {\n"
            ' for (int i = 0; i < 3; ++i) printf("%.17g\\n", MAGCAL_HARD_IRON[i]);\n'
            ' for (int i = 0; i < 9; ++i) printf("%.17g\\n", MAGCAL_MATRIX[i / 3][i % 3]);\n'
            " return 0;\n}\n"
        )
        command = [compiler, "-Wall", "-Werror", "-o", folder / "main", folder / "main.c"]
        subprocess.run(command, check=True, timeout=240)
        done = subprocess.run([folder / "main"], check=True, capture_output=True, timeout=240)
        twelve = np.array([float(word) for word in done.stdout.split()])
    hard, matrix = twelve[:3], twelve[3:].reshape(3, 3)
    return lambda mag: (mag - hard) @ matrix.T
