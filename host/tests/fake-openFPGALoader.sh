#!/bin/sh
# What openFPGALoader prints, case by case ($FAKE), with nothing behind it. Texts of version 0.10
# (Debian 12) and 1.0. Every call is noted in $FAKE_LOG.
echo "$@" >> "$FAKE_LOG"
case "$*" in
--list-cables)
    printf 'cable name               vid:pid\ndirtyJtag                0x1209:c0ca\nft232                    0x0403:6014\nlibgpiod                 0x0000:0000\n'
    exit 0 ;;
esac
last() { for last in "$@"; do :; done; echo "$last"; }
bar() { printf '\r%s: [%-50s] %s%%' "$1" "====" "$2"; }
# An FPGA that does not want to be configured: a register, then FAIL on stderr.
stubborn() { printf 'Enable configuration: displayReadReg\n\tConfig Target Selection : 0\n\tNo err\n'; echo FAIL >&2; }
found() { printf 'index 0:\n\tidcode 0x%s\n\tmanufacturer lattice\n\tfamily ECP5\n\tmodel  %s\n\tirlength 8\n' "$1" "$2"; }
case "$FAKE" in
no-cable) # 0.10
    echo 'unable to open ftdi device: -3 (device not found)' >&2
    echo 'JTAG init failed with: unable to open ftdi device' >&2
    exit 1 ;;
no-cable-1.0)
    echo 'No cable found' >&2
    echo 'JTAG init failed with: No cable found' >&2
    exit 1 ;;
permission) # 0.10 with libftdi 1.5
    echo 'unable to open ftdi device: -4 (libusb_open() failed)' >&2
    echo 'JTAG init failed with: unable to open ftdi device' >&2
    exit 1 ;;
permission-8)
    echo 'unable to open ftdi device: -8 (inappropriate permissions on device!)' >&2
    echo 'JTAG init failed with: unable to open ftdi device' >&2
    exit 1 ;;
permission-1.0)
    echo 'Unable to open device: 0403:6014 (bus 1, device  5) Error: LIBUSB_ERROR_ACCESS -> skip' >&2
    echo 'JTAG init failed with: No cable found' >&2
    exit 1 ;;
busy)
    echo 'unable to open ftdi device: -5 (unable to claim usb device. Make sure the default FTDI driver is not in use)' >&2
    echo 'JTAG init failed with: unable to open ftdi device' >&2
    exit 1 ;;
unknown-cable)
    echo "error : $2 not found" >&2
    exit 1 ;;
no-fpga) # nothing in the chain: --detect succeeds with nothing to say
    exit 0 ;;
stuck)
    echo 'JTAG init failed with: TDO is stuck at 0' >&2
    exit 1 ;;
esac
case "$*" in
*--detect*)
    case "$FAKE" in
    wrong-fpga) found 1112043 LFE5UM-45 ;; # 0.10 shows no upper four bits
    wrong-fpga-1.0) found 41112043 LFE5U-45 ;;
    fine-1.0 | same-die) found 41111043 LFE5U-25 ;;
    *) found 1111043 LFE5UM-25 ;;
    esac
    exit 0 ;;
*--dump-flash*)
    # 0.10 calls this a success.
    [ "$FAKE" = stubborn ] && { stubborn; exit 0; }
    printf 'dump flash (May take time)\nOpen dump file DONE\n'
    bar 'Read flash ' 50.00; bar 'Read flash ' 100.00
    cp "$FAKE_FLASH" "$(last "$@")"
    printf '\nDone\n'
    exit 0 ;;
*-f*--unprotect-flash*)
    printf 'Open file DONE\nParse file DONE\n'
    [ "$FAKE" = stubborn ] && { stubborn; echo 'Error: Failed to program FPGA: std::exception' >&2; exit 1; }
    printf 'Enable configuration: DONE\nSRAM erase: DONE\n'
    printf 'JEDEC ID: 0xef4016\nDetected: Winbond W25Q32 64 sectors size: 32Mb\n'
    case "$FAKE" in
    protected)
        echo 'Error: block protection is set' >&2
        echo "       can't unlock without --unprotect-flash" >&2
        exit 1 ;;
    stays-protected)
        echo 'disable protection failed' >&2
        exit 1 ;;
    no-flash)
        echo 'SPI Flash prepare access failed' >&2
        exit 1 ;;
    esac
    bar Erasing 30.00; bar Erasing 100.00; printf '\nDone\n'
    bar Writing 50.00; bar Writing 100.00; printf '\nDone\n'
    printf 'Verifying write (May take time)\n'
    if [ "$FAKE" = verify ]; then
        echo 'Verification failed at 4096' >&2
        exit 0
    fi
    [ -n "$FAKE_FLASH" ] && cp "$(last "$@")" "$FAKE_FLASH"
    printf 'Refresh: DONE\n'
    exit 0 ;;
*-m*)
    printf 'Open file: DONE\nParse file: DONE\n'
    if [ "$FAKE" = same-die ]; then
        printf "mismatch between target's idcode and bitstream idcode\n" >&2
        printf '\tbitstream has 0x41111043 hardware requires 0x21111043\n' >&2
        echo 'Error: Failed to program FPGA: std::exception' >&2
        exit 1
    fi
    printf 'Enable configuration: DONE\nSRAM erase: DONE\n'
    if [ "$FAKE" = odd ]; then
        echo 'FAIL: the moon is in the wrong house' >&2
        exit 1
    fi
    bar Loading 40.00; bar Loading 100.00; printf '\nDone\n'
    printf 'Disable configuration: DONE\n'
    exit 0 ;;
esac
echo "fake openFPGALoader: what is $*?" >&2
exit 1
