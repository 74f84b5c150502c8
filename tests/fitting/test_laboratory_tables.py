"""Tables as laboratories write them: one response under many headings, units, separators and encodings."""

import h5py
import numpy as np
import pytest
import scipy

from support.scenes import refused
from warp_plate.fitting.measured_modes import read_modes
from warp_plate.fitting.measured_responses import read_responses
from warp_plate.scene.fit import Fit, Measurement

HERTZ, VALUES = np.array([10.0, 20.0, 40.0]), np.array([1 + 2j, -3 + 0.5j, 0.25 - 4j])
OMEGA, GRAVITY = 2j * np.pi * HERTZ, 9.80665
FREE = {"plate.density": (1.0, 2.0)}


def row(quantity="accelerance"):
    return Measurement(force_at=(0.25, 0.18), point=(0.22, 0.05), quantity=quantity)


def table(heading, columns, mark=",", comma=False, above=""):
    """Return the text of a table of columns."""
    lines = [mark.join(f"{value:.15g}" for value in values) for values in np.column_stack(columns)]
    body = "\n".join(lines)
    return above + heading + "\n" * bool(heading) + (body.replace(".", ",") if comma else body) + "\n"


def parts(values=VALUES):
    return [HERTZ, values.real, values.imag]


def polar(values=VALUES, degrees=True, decibels=False):
    size = 20 * np.log10(np.abs(values)) if decibels else np.abs(values)
    return [HERTZ, size, np.angle(values, deg=degrees)]


TABLES = {
    "none": table("", parts()),
    "names": table("Frequency,Real,Imag", parts()),
    "brackets": table("Frequency [Hz],Re(H1) [m/s2/N],Im(H1) [m/s2/N]", parts()),
    "parentheses": table("Frequency (Hz),Real (m/s^2/N),Imaginary (m/s^2/N)", parts()),
    "kilohertz": table("Frequency (kHz),Real,Imag", [HERTZ / 1e3, *parts()[1:]]),
    "kilohertz after the name": table("Freq_kHz,Real,Imag", [HERTZ / 1e3, *parts()[1:]]),
    "radians per second": table("omega [rad/s],Re,Im", [OMEGA.imag, *parts()[1:]]),
    "revolutions": table("Frequency in rpm,Re,Im", [60 * HERTZ, *parts()[1:]]),
    "magnitude and degrees": table("Frequency (Hz),Magnitude (m/s2/N),Phase (deg)", polar()),
    "magnitude and radians": table("f / Hz,|H|,arg H [rad]", polar(degrees=False)),
    "decibels": table("Freq,Mag (dB),Phase (°)", polar(decibels=True)),
    "decibels of a reference": table("Freq,Mag (dB re 1 m/s2/N),Phase [deg]", polar(decibels=True)),
    "decibels of gravity": table("Freq,Mag [dB rel 1 g/N],Phase [deg]", polar(VALUES / GRAVITY, decibels=True)),
    "all four": table("f,Re,Im,Mag,Phase", [*parts(), *polar()[1:]]),
    "phase first": table("Phase (deg),Magnitude,Frequency", polar()[::-1]),
    "gravity": table("Frequency,Real (g/N),Imag (g/N)", parts(VALUES / GRAVITY)),
    "millimetres": table("Frequency,Real ((mm/s²)/N),Imag ((mm/s²)/N)", parts(1e3 * VALUES)),
    "per pound": table("Frequency,Real (m/s2/lbf),Imag (m/s2/lbf)", parts(VALUES * 4.4482216152605)),
    "per kilogram": table("Frequency,Real [1/kg],Imag [1/kg]", parts()),
    "mobility": table("Frequency,Real (m/s/N),Imag (m/s/N)", parts(VALUES / OMEGA)),
    "mobility in other words": table("Frequency,Real [m/(N s)],Imag [m/(N s)]", parts(VALUES / OMEGA)),
    "receptance": table("Frequency,Real (um/N),Imag (um/N)", parts(1e6 * VALUES / OMEGA**2)),
    "semicolons": table("Frequenz;Re;Im", parts(), ";"),
    "decimal commas": table("Frequenz;Realteil;Imaginärteil", parts(), ";", comma=True),
    "commas and tabs": table("f\tRe\tIm", parts(), "\t", comma=True),
    "spaces": table("", parts(), " "),
    "spaces and commas": table("", parts(), "  ", comma=True),
    "quotes": table('"f","Re","Im"', parts()).replace("0.25,", '"0.25",'),
    "quoted commas": 'f,Re,Im\n"10,0","1,0","2,0"\n20,-3,"0,5"\n40,"0,25",-4\n',
    "separator": table("sep=;\nf;Re;Im", parts(), ";"),
    "preamble": table("Frequency,Real,Imag", parts(), above="File,test.csv\nDate,2024-01-01\nSensor,ACC1\n\n"),
    "row of units": table("Frequency,Real,Imag\nkHz,g/N,g/N", [HERTZ / 1e3, *parts(VALUES / GRAVITY)[1:]]),
    "comment": table("# Frequency (Hz),Magnitude,Phase (deg)", polar(), above="# bench 3\n"),
}  # fmt: skip


@pytest.mark.parametrize("name", TABLES)
def test_headings(name, tmp_path):
    (tmp_path / "a.csv").write_text(TABLES[name], encoding="utf-8")
    found = read_responses(tmp_path / "a.csv", 1, rows=[row()])
    np.testing.assert_allclose(found.frequencies, HERTZ, rtol=1e-12)
    np.testing.assert_allclose(found.responses, [VALUES], rtol=1e-12)
    assert len(found.remarks) == (name.startswith(("mobility", "receptance")))


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "latin-1"])
def test_encodings(encoding, tmp_path):
    (tmp_path / "a.csv").write_bytes(TABLES["decimal commas"].replace("\n", "\r\n").encode(encoding))
    np.testing.assert_allclose(read_responses(tmp_path / "a.csv", 1).responses, [VALUES], rtol=1e-12)


def test_coherence_and_several_responses(tmp_path):
    columns = [*polar(), np.full(3, 0.9), *polar(2 * VALUES)[1:], np.full(3, 0.8)]
    heading = "Frequency,Mag 1,Phase 1 (deg),Coherence 1,Mag 2,Phase 2 (deg),Coherence 2"
    (tmp_path / "a.csv").write_text(table(heading, columns))
    found = read_responses(tmp_path / "a.csv", 2)
    np.testing.assert_allclose(found.responses, [VALUES, 2 * VALUES])
    np.testing.assert_array_equal(found.coherence, [[0.9] * 3, [0.8] * 3])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (table("Frequency,Magnitude,Phase", polar()), "column 'Phase': name its unit, such as 'Phase (deg)'"),
        (table("Frequency,Magnitude,Phase (turns)", polar()), "column 'Phase (turns)': the unit of a phase must be"),
        (table("Frequency (furlong),Re,Im", parts()), "the unit of a frequency must be hz, khz"),
        (table("Frequency,Magnitude,Phase (deg)", polar(VALUES / 10, decibels=True)), "is negative; if it is in decib"),
        (table("Frequency,Magnitude,Imag", parts()), "each response needs a real and a imaginary column"),
        (table("Frequency,Magnitude,Coherence", polar()), "each response needs a magnitude and a phase column"),
        (table("f,Re (m/s/N),Im (m/s2/N)", parts()), "name different units"),
        (table("time [s],force,acceleration", parts()), "its first column is time; write [fit.signals]"),
        (table("f,Re,Im", parts(), comma=True), "a.csv: not a table of numbers with decimal points"),
    ],
)
def test_contradictory_headings_are_refused(text, message, tmp_path):
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    assert message in refused(read_responses, tmp_path / "a.csv", 1)


MODES = {
    "plain": "frequency,damping\n18.9,0.005\n63.1,\n",
    "kilohertz": "mode,frequency [kHz],damping [%]\n1,0.0189,0.5\n2,0.0631,\n",
    "radians": f"Frequency (rad/s);Zeta\n{18.9 * 2 * np.pi};0,005\n{63.1 * 2 * np.pi};\n",
    "decimal commas": 'frequency,damping\n"18,9","0,005"\n"63,1",""\n',
    "separator": "sep=;\nEigenfrequenz (Hz);Dämpfung (%)\n18,9;0,5\n63,1;\n",
    "loss factor": "Natural frequency (Hz),Loss factor (%)\n18.9,1\n63.1,0\n",
    "no damping": "frequency,damping\n18.9,0.005\n63.1,0\n",
    "rigid motions": "frequency,damping\n-1e-4,0.9\n0,0\n18.9,0.005\n63.1,\n",
    "preamble": "Panel 3\nby hammer, 2024\nfrequency,damping\nHz,%\n18.9,0.5\n63.1,\n",
}


@pytest.mark.parametrize("name", MODES)
def test_tables_of_modes(name, tmp_path):
    (tmp_path / "a.csv").write_text(MODES[name], encoding="utf-8")
    found = read_modes(tmp_path / "a.csv")
    np.testing.assert_allclose(found.frequencies, [18.9, 63.1], rtol=1e-12)
    np.testing.assert_allclose(found.damping, [0.005, np.nan], rtol=1e-12)


def test_unquoted_decimal_commas_are_named(tmp_path):
    (tmp_path / "a.csv").write_text("frequency,damping\n18,9,0,005\n")
    message = "line 2 has 4 columns; the first line names 2; columns with decimal commas are separated by semicolons"
    assert message in refused(read_modes, tmp_path / "a.csv")


def test_points_in_millimetres_about_the_centre(tmp_path):
    (tmp_path / "a.csv").write_text("frequency,shape -105 100,shape 0 0\n20,1,-2\n")
    found = read_modes(tmp_path / "a.csv", Fit(free=FREE, origin=(0.115, 0.12), unit="mm"))
    np.testing.assert_allclose(found.points, [[0.01, 0.22], [0.115, 0.12]])


@pytest.mark.parametrize(
    ("heading", "signals", "factor"),
    [
        ("time [s],force [N],acceleration [m/s2]\n", {}, 1.0),
        ("Time (ms),Force (N),Acc (g)\n", {}, GRAVITY),
        ("", {"rate": 1000.0}, 1.0),
        ("Force (kN),Acc\n", {"rate": 1000.0}, 1.0),
        ("Force (mN),Acc (mm/s^2)\n", {"rate": 1000.0}, 1.0),
        ("t [s],F [N],real a [m/s2]\n", {}, 1.0),
    ],
)
def test_time_signals(heading, signals, factor, random, tmp_path):
    """Units of both channels count; the rate stands for a column of times."""
    force = random.normal(size=500)
    times = np.arange(500) / (1000.0 if "[s]" in heading else 1.0)
    columns = [force, 3 * force] if signals else [times, force, 3 * force]
    (tmp_path / "a.csv").write_text(heading + table("", columns))
    table_of = {"window": "boxcar", "segment": 0.1, **signals}
    found = read_responses(tmp_path / "a.csv", 1, Fit(free=FREE, signals=table_of), [row()])
    np.testing.assert_allclose(found.frequencies[:2], [10, 20], rtol=1e-9)
    np.testing.assert_allclose(found.responses, 3 * factor, rtol=1e-9)


def test_a_rate_besides_times_is_refused(tmp_path):
    (tmp_path / "a.csv").write_text("time,force,motion\n" + table("", [HERTZ, HERTZ, HERTZ]))
    fit = Fit(free=FREE, signals={"rate": 100.0})
    assert "has a column of times; delete fit.signals.rate" in refused(read_responses, tmp_path / "a.csv", 1, fit)


@pytest.mark.parametrize("signals", [{"rate": 8000.0}, {}])
@pytest.mark.parametrize("heading", ["frequency [Hz],real,imag", "f,Re,Im", "x,y,Coherence", "Freq,Mag,Phase (deg)"])
def test_responses_are_not_taken_for_time_signals(heading, signals, tmp_path):
    (tmp_path / "a.csv").write_text(table(heading, [HERTZ, HERTZ, HERTZ]))
    message = refused(read_responses, tmp_path / "a.csv", 1, Fit(free=FREE, signals=signals))
    column = heading.split(",")[2 if heading.startswith("x") else 0]
    assert message.startswith(f"{tmp_path / 'a.csv'}: column '{column}': has a column of responses; delete [fit.sig")


@pytest.mark.parametrize("version", ["4", "5", "struct", "nested 7.3", "7.3"])
def test_versions_of_mat_files(version, tmp_path):
    path, arrays = tmp_path / "a.mat", {"frequency": HERTZ, "response": VALUES}
    if version in ("4", "5"):
        scipy.io.savemat(path, arrays, format=version)
    elif version == "struct":
        scipy.io.savemat(path, {"other": 1.0, "frf": arrays}, do_compression=True)
    else:
        pairs = np.empty((1, 3), dtype=[("real", "f8"), ("imag", "f8")])
        pairs["real"], pairs["imag"] = VALUES.real, VALUES.imag
        with h5py.File(path, "w", userblock_size=512) as file:
            group = file.create_group("frf") if "nested" in version else file
            group["frequency"], group["response"] = HERTZ[None], pairs
    np.testing.assert_array_equal(read_responses(path, 1).responses, [VALUES])


def test_names_of_other_arrays_are_listed(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"f": HERTZ, "FRF": VALUES})
    assert "it holds f (1x3 double), FRF (1x3 double)" in refused(read_responses, tmp_path / "a.mat", 1)
    scipy.io.savemat(tmp_path / "a.mat", {name: {"frequency": HERTZ, "response": VALUES} for name in ("one", "two")})
    assert "the structs one, two have such arrays" in refused(read_responses, tmp_path / "a.mat", 1)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["data/x"], file["f"] = HERTZ, HERTZ
    assert "it holds data/, f (3,)" in refused(read_responses, tmp_path / "a.h5", 1)


def test_a_struct_that_unpacks_to_too_much_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("warp_plate.result.hdf5.UNPACKED_BYTES", 2**16)
    scipy.io.savemat(tmp_path / "a.mat", {"frf": {"frequency": HERTZ, "x": np.zeros(10_000)}}, do_compression=True)
    assert "when unpacked" in refused(read_responses, tmp_path / "a.mat", 1)
