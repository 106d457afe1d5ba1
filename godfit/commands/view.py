"""``godfit view``: the page of a result."""

from __future__ import annotations

import webbrowser
from pathlib import Path

import click

from godfit.commands.options import Command
from godfit.errors import InputError


@click.command(cls=Command)
@click.argument("fit_json", metavar="FIT.JSON")
@click.option(
    "--open/--no-open", "opened", default=True, help="Open it in the browser. [default: yes]"
)
def view(fit_json: str, opened: bool) -> int:
    """Open the page of FIT.JSON, or of a result's folder, in the browser.

    Where report.html is not beside FIT.JSON it is made from the images that FIT.JSON names. The
    page's path goes to stdout.
    """
    from godfit.report.files import PAGE

    record = Path(fit_json)
    page = (record if record.is_dir() else record.parent) / PAGE
    if not record.exists():
        raise InputError(f"'{fit_json}': expected a fit.json or a folder of results, got no file")
    if not page.is_file():
        write_page(str(record / "fit.json" if record.is_dir() else record), page)
    click.echo(str(page))
    if opened:
        webbrowser.open(page.resolve().as_uri())
    return 0


def write_page(fit_json: str, page: Path) -> None:
    """Make the page of a fit from the files that its record names. Raises InputError where they
    cannot be found."""
    from godfit.commands.study import start_jax

    start_jax()
    from godfit.io.image import LEVELS, read_image
    from godfit.report.files import page_writer
    from godfit.report.pages import record_page
    from godfit.report.record import read_record, recorded

    record = read_record(fit_json)
    images = recorded(fit_json)
    path = record.get("inputs", {}).get("target", {}).get("path")
    if not path:
        raise InputError(f"'{fit_json}': expected the path of a target in it, got none; fit again")
    target = read_image(path, transfer=images.transfer).encoded * LEVELS
    target = target.reshape(*target.shape[:2], -1)
    page_writer(lambda: record_page(record, images, target).html())(page)
