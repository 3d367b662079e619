//! Jobs on the models of the cores: the program that executes them, the firmware's server, the segments core, and the pins.

mod rig;

mod console;
mod ends;
mod homing;
mod peers;
mod programs;
mod sessions;
mod tcp;
mod uploads;
mod words;
