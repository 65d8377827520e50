"""The path-tracking task of the paper as environments: gymnasium, stable-baselines3's VecEnv, dm_control."""
