"""What a diagnosis shows people (report.html) and programs (diagnosis.json)."""

from calibration.diagnosis.report.document import document
from calibration.diagnosis.report.page import verdict, write_diagnosis

__all__ = ["document", "verdict", "write_diagnosis"]
