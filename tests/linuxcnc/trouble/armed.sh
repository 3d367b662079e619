#!/usr/bin/env bash
# Asks to arm until the board is armed: a request before the board was ready is used up, and a
# period in lockstep has no fixed length.
pin=ferrocnc.0
for _ in $(seq 200); do
    halcmd setp $pin.enable-request 0
    sleep 0.01
    halcmd setp $pin.enable-request 1
    for _ in $(seq 20); do
        sleep 0.01
        [ "$(halcmd getp $pin.enabled)" = TRUE ] && exit 0
    done
done
exit 1
