"""From camera frames to what policies see: packed frames, the encoder, how it is pretrained, what its features tell."""
