//! Jobs on the models of the cores: the program that executes them, the firmware's server, the
//! segments core, and the pins.

mod lan;
mod rig;

mod board;
mod busy;
mod console;
mod consoles;
mod ends;
mod here;
mod homing;
mod peers;
mod programs;
mod sessions;
mod stops;
mod tcp;
mod uploads;
mod words;
