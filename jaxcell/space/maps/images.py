"""Pictures of files that may be damaged."""

import warnings
from io import BytesIO

from PIL import Image


def read_image(content: bytes, formats: tuple[str, ...] | None = None) -> Image.Image:
    """Decode a picture.

    **Arguments:**

    - `content`: the bytes of the file.
    - `formats`: those of Pillow that are expected; by default any.

    **Raises:** `PIL.UnidentifiedImageError` if it is of none of them; `ValueError` if it is too
    large, broken or cut short.
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
    except Exception as error:  # Pillow's decoders leak errors of many types on broken files.
        raise ValueError(f"broken or cut short: {error}") from error
    return image
