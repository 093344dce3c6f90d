/* ATmega2560 at 16 MHz: 512 records of 8 bytes leave 4 kB of its 8 kB for stack and buffers. */
#define BOX_NAME "wafer_viewer_pulse_box_atmega2560"
#define BOX_RING 512
#define BOX_RATE 40000
#define BOX_WIDTH_MIN_US 20
#define BOX_WIDTH_MAX_US 10000
#define BOX_TICKS_PER_US 2 /* timer 1 at clock / 8 */
#define BOX_LINKS 1
