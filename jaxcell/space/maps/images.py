from io import BytesIO

from PIL import Image


MOST_PIXELS = 2**27
"Largest number of pixels of a picture."


def read_image(content: bytes, formats: tuple[str, ...] | None = None) -> Image.Image:
    """Decode a picture in one of the given formats, by default any format that Pillow knows.

    **Raises:** `PIL.UnidentifiedImageError` for another format; `ValueError` for a picture that is
    too large, broken or cut short.
    """
    usual, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
    try:
        image = Image.open(BytesIO(content), formats=formats)
        too_large = image.width * image.height > MOST_PIXELS
        if not too_large:
            image.load()
    except Image.UnidentifiedImageError:
        raise
    except Exception as error:  # Pillow's decoders raise many types of errors for broken files.
        raise ValueError("broken or cut short; copy or save the picture again") from error
    finally:
        Image.MAX_IMAGE_PIXELS = usual
    if too_large:
        most = f"at most {MOST_PIXELS:,}: save a part of the picture, or shrink it"
        raise ValueError(f"too large: {image.width:,} x {image.height:,} pixels; expected {most}")
    return image
