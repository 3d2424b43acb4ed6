"""Drawing: figures by matplotlib, and figures of one image by Pillow."""
