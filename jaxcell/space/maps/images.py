import warnings
from io import BytesIO

from PIL import Image


def read_image(content: bytes, formats: tuple[str, ...] | None = None) -> Image.Image:
    """Decode a picture in one of the given formats, by default any format that Pillow knows.

    **Raises:** `PIL.UnidentifiedImageError` for another format; `ValueError` for a picture that is
    too large, broken or cut short.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            image = Image.open(BytesIO(content), formats=formats)
        image.load()
    except Image.UnidentifiedImageError:
        raise
    except (Image.DecompressionBombWarning, Image.DecompressionBombError) as error:
        raise ValueError(f"too large: {error}") from None
    except Exception as error:  # Pillow's decoders raise many types of errors for broken files.
        raise ValueError(f"broken or cut short: {error}") from error
    return image
