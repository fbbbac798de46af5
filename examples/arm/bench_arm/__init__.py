"""A made-up arm and made-up cameras, both reached by TCP with lines of text: a request, an answer; or a stream.

Arm, port 4001, lengths in m, rotation vector in rad, base frame:
    ID                                      ID bench-arm
    GO x y z rx ry rz speed acceleration    OK
    STOP                                    OK
    POSE                                    POSE t x y z rx ry rz speed moving
    STREAM                                  such POSE lines, 50 a second, from then on
Cameras, port 4002, streams to whoever connects, robot's base frame:
    t frame tracked x y z qw qx qy qz m1x m1y m1z ..
"""

ARM_PORT, CAMERA_PORT = 4001, 4002
