"""The calibration under the hand: errors by frame, and fits that follow when a frame is left out."""
