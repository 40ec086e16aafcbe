"""Plot an object's height over time with its standard deviation, from a file that `tracker track` wrote."""

import matplotlib

matplotlib.use("Agg")  # no window
import matplotlib.pyplot as plt
import numpy as np

import tracker

poses = tracker.read_poses("poses.h5")
time = poses.timestamp - poses.timestamp[0]  # [s]
height = 1e3 * poses.filtered.position[:, 2]  # [mm], NaN where there is no pose
std = 1e3 * np.sqrt(poses.filtered.covariance[:, 2, 2])

figure, axis = plt.subplots(figsize=(8, 3), layout="constrained")
axis.fill_between(time, height - 2 * std, height + 2 * std, alpha=0.3, label="± 2 standard deviations")
axis.plot(time, height, label="centre of the object")
for moment in time[poses.status == "lost"]:
    axis.axvline(moment, color="tab:red", alpha=0.5)
axis.set_xlabel("time [s]")
axis.set_ylabel("height [mm]")
axis.legend()
figure.savefig("height.png")
