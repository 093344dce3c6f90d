/* RP2040 at 125 MHz, as on the Raspberry Pi Pico. */
#define BOX_NAME "wafer_viewer_pulse_box_rp2040"
#define BOX_RING 1024
#define BOX_RATE 500000
#define BOX_WIDTH_MIN_US 1
#define BOX_WIDTH_MAX_US 10000
#define BOX_TICKS_PER_US 1
#define BOX_LINKS 2 /* UART and USB */
