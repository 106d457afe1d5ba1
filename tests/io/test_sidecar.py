"""The file of options beside a target."""

from godfit.io.sidecar import read_sidecar


def test_a_byte_order_mark_is_no_text(tmp_path):
    """Editors on Windows begin a file with one."""
    text = 'mask = "m.png"\n[scattering]\nshader = "dawntime"\nsamples = 30\n'
    expected = {"mask": str(tmp_path / "m.png"), "shader": "dawntime", "samples": 30}
    for mark in (b"", b"\xef\xbb\xbf"):
        (tmp_path / "x.toml").write_bytes(mark + text.encode())
        assert read_sidecar(str(tmp_path / "x.png")) == expected


def test_a_shader_in_a_file_lies_beside_it(tmp_path):
    (tmp_path / "x.toml").write_text('mask = "m.png"\n[scattering]\nshader = "mine.toml"\n')
    assert read_sidecar(str(tmp_path / "x.png"))["shader"] == str(tmp_path / "mine.toml")
