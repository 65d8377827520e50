"""What a diagnosis shows people (report.html) and programs (diagnosis.json)."""
