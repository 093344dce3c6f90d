#define BOX_NAME "wafer_viewer_pulse_box_host"
#define BOX_RING 512
#define BOX_RATE 1000000
#define BOX_WIDTH_MIN_US 1
#define BOX_WIDTH_MAX_US 10000
#define BOX_TICKS_PER_US 1
#define BOX_LINKS 2
