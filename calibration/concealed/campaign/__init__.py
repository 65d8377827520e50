"""Many concealed cases, diagnosed blind and scored."""

from calibration.concealed.campaign.cases import Case, draw_cases
from calibration.concealed.campaign.run import run_case
from calibration.concealed.campaign.score import score_table

__all__ = ["Case", "draw_cases", "run_case", "score_table"]
