"""Where a robot is, by what it sees: images at known places, descriptors of whole images, a probability over places."""
