"""The PR-4, a made-up box of up to four pressure regulators on one serial line, at 57600 Bd, lines ended by LF:

ID?              PR4,SN0042,FW1.3
SP?              SP 0,5000,0          set-points, units of 10 Pa
SP 0,5000,0      SP 0,5000,0          sets all channels, answers what it holds
PV?              PV 3,4998,1          measured
anything else    ERR 1
"""

BAUD = 57600
COUNT = 10.0
"""Pa."""
