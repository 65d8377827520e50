"""How uncertain fitted parameters are: by the recordings' disturbances, and by the twin's own form."""
