#!/bin/sh
# First process of the user-mode Linux that machine.py, beside, boots: makes vcan0, runs the job, switches off.
# $job/settings and $job/command say what to run and how. The exit status goes to $job/status.
# tty1 and tty2 carry the command's output and errors.
# tty3 carries signals for the command, one name a line. It closes when nobody waits for the job any more.
export PATH=/usr/sbin:/usr/bin:/sbin:/bin
exec 3>/dev/tty1 4>/dev/tty2 </dev/null

mount -t proc proc /proc
mount -t sysfs sysfs /sys
mount -t tmpfs tmpfs /run
mkdir /dev/pts /dev/shm /run/lib
mount -t devpts devpts /dev/pts
mount -t tmpfs tmpfs /dev/shm
. "$job/settings"
echo "$host" >/proc/sys/kernel/hostname

ln -s /usr/lib/uml/modules /run/lib/modules
modprobe -a -d /run can-raw can-bcm vcan slcan
ip -batch - <<END
link set lo up
link add dev vcan0 type vcan
link set vcan0 up
END

stty raw -echo rows "$rows" columns "$columns" <&3
stty raw -echo rows "$rows" columns "$columns" <&4
{
    while read -r signal; do
        until [ -s /run/group ]; do sleep 0.1; done
        read -r group </run/group
        kill -s "$signal" -- "-$group"
    done </dev/tty3
    rm -r "$job"
    echo o >/proc/sysrq-trigger
} &
control=$!

run='echo $$ >/run/group; exec sh "$0/command" 3>&- 4>&-'
if [ "$is_terminal" = yes ]; then
    setsid -w sh -c "$run" "$job" >&3 2>&4
    status=$?
else # pipes as outside, so that the command does not take its output for a terminal
    mkfifo /run/output /run/errors
    cat /run/output >&3 &
    output=$!
    cat /run/errors >&4 &
    errors=$!
    setsid -w sh -c "$run" "$job" >/run/output 2>/run/errors
    status=$?
fi

# Processes that the job left behind are killed. What they wrote is still passed on.
for process in /proc/[1-9]*; do
    case ${process#/proc/} in
    1 | "$control" | "$output" | "$errors") ;;
    *) kill -s KILL "${process#/proc/}" ;;
    esac
done 2>/dev/null
[ "$is_terminal" = yes ] || wait "$output" "$errors"
stty -raw <&3 # returns when all output is written
stty -raw <&4
echo "$status" >"$job/status"
sync
echo o >/proc/sysrq-trigger
wait
