//! Pixel formats as a driver of the kernel's packs them: the same test picture in each must be read as the same picture.
