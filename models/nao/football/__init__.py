"""A football field, two robots on it and a ball: the pictures of their cameras, and how they find the ball."""

try:
    import cv2  # noqa: F401
except ModuleNotFoundError:
    raise ModuleNotFoundError("this world's units need OpenCV: pip install 'cfgplan[demo]'", name="cv2") from None
