"""What a box is: values, arrays, fits, shapes. Everything is checked here, at the edge."""
