"""Sitting an exam: sealed cases of strangers' cars, their answers, their scores and the page."""
