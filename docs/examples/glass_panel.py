"""A glass panel with six actuators: find the drive that moves only a disc of 30 mm, and vary its frequency."""

import warp_plate as wpl

plate = wpl.Plate(size=(0.2, 0.12), thickness=0.7e-3, young_modulus=72e9, poisson_ratio=0.22, density=2480)
places = [(x, y) for y in (0.01, 0.1) for x in (0.03, 0.095, 0.16)]  # lower left corners [m]
scene = wpl.Scene(
    title="Glass panel",
    plate=plate,
    actuators=[wpl.Actuator(name=f"{x:g}, {y:g}", area=(x, x + 0.01, y, y + 0.01)) for x, y in places],
    drive=wpl.Drive(frequency=300),
    target=wpl.Target(disc=(0.13, 0.06, 0.015)),
)
result = wpl.localize(scene)
print(result)
wpl.plot(result, "glass-panel")
wpl.save_result(result, "glass-panel.h5")

found = wpl.sweep(scene, ["drive.frequency=200:400:5"])
print(found.shaped("best"))
wpl.plot(found, "glass-panel-sweep")
