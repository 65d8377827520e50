"""The car: its MuJoCo model and its measured numbers; installed as `qcar_twin.assets`."""
