"""One self-contained HTML page per run: `page` writes it, `style` has the colours every figure shares."""

from calibration.reports.page import Picture, Section, Table, picture, write_page

__all__ = ["Picture", "Section", "Table", "picture", "write_page"]
