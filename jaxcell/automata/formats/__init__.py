"""Write filters, machines and policies for other programs and for microcontrollers."""
