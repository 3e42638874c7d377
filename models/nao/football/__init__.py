"""A simulated football field, two robots and a ball: the cameras' pictures, and the algorithms that find the ball."""

try:
    import cv2  # noqa: F401
except ModuleNotFoundError:
    raise ModuleNotFoundError("this world's units need OpenCV: pip install 'cfgplan[demo]'", name="cv2") from None
