"""The ASTERIX categories as data: what items there are, how long they are, what bits they hold, and what columns they fill.

Nothing here runs while a file is read; `asterix` compiles these tables into arrays once.  A new category, edition or element is a
line of text here.

One line of a category is ``FRN ITEM STRUCTURE FIELDS…`` (FRN: the bit's number in the FSPEC; numbers left out are undefined).

Structures: ``4`` four bytes; ``1+`` one byte, then more while the last bit (FX) is set; ``3+3`` the same in steps of three
bytes; ``1?1`` one byte, then at most one more that has no FX; ``*8`` a count, then that many times eight bytes; ``L`` a length
(counting itself), then bytes; ``{}`` compound: the sub-items follow on lines that start with a dot, in the order of the
subfield's own FSPEC; ``R`` random field sequencing: a count, then that many times an FRN and its item.

Fields, from the first bit: ``NAME:bits``, an ``s`` before the bits for two's complement, an ``a`` for six-bit characters,
``*LSBunit`` for a quantity (``RHO:16*1/256NM``), ``_n`` for n spare bits, ``/`` where the FX bit closes a part.  A trailing
backslash continues a line.  Names and bits are those of EUROCONTROL's category documents.
"""

from __future__ import annotations

import re
from functools import cache
from typing import NamedTuple

from ..errors import SettingsError
from ..model import Channel, Flag

# What one of each unit is in SI.  Units that no column needs (dBm, counts of degrees Celsius) keep their own.
SI = {
    "": 1.0,
    "NM": 1852.0,
    "m": 1.0,
    "deg": 0.017453292519943295,
    "s": 1.0,
    "FL": 30.48,
    "ft": 0.3048,
    "kt": 1852.0 / 3600.0,
    "m/s": 1.0,
    "m/s2": 1.0,
    "NM/s": 1852.0,
    "ft/min": 0.3048 / 60.0,
    "deg/s": 0.017453292519943295,
    "C": 1.0,
    "dBm": 1.0,
    "MHz": 1.0,
    "Mach": 1.0,
    "mb": 1.0,
    "ms": 0.001,
}

# Category 001 has two lists of items: one for plots, one for tracks; the first bit of I001/020 tells which.
_CAT001 = """
1  010 2   SAC:8 SIC:8
2  020 1+  TYP:1 SIM:1 SSRPSR:2 ANT:1 SPI:1 RAB:1 / TST:1 DS1DS2:2 ME:1 MI:1 _2 /
3  040 4   RHO:16*1/128NM THETA:16*360/2^16deg
4  070 2   V:1 G:1 L:1 _1 MODE3A:12
5  090 2   V:1 G:1 HGT:s14*1/4FL
6  130 1+  130:7 /
7  141 2   141:16*1/128s
8  050 2   V:1 G:1 L:1 _1 MODE2:12
9  120 1   120:s8*1/256NM/s
10 131 1   131:s8*1dBm
11 080 2   _4 QA4:1 QA2:1 QA1:1 QB4:1 QB2:1 QB1:1 QC4:1 QC2:1 QC1:1 QD4:1 QD2:1 QD1:1
12 100 4   V:1 G:1 _2 MODEC:12 _4 QC1:1 QA1:1 QC2:1 QA2:1 QC4:1 QA4:1 QB1:1 QD1:1 QB2:1 QD2:1 QB4:1 QD4:1
13 060 2   _4 QA4:1 QA2:1 QA1:1 QB4:1 QB2:1 QB1:1 QC4:1 QC2:1 QC1:1 QD4:1 QD2:1 QD1:1
14 030 1+  030:7 /
15 150 1   XA:1 _1 XC:1 _2 X2:1 _2
20 SP  L
21 RFS R
"""

_CAT001_TRACK = """
1  010 2   SAC:8 SIC:8
2  020 1+  TYP:1 SIM:1 SSRPSR:2 ANT:1 SPI:1 RAB:1 / TST:1 DS1DS2:2 ME:1 MI:1 _2 /
3  161 2   161:16
4  040 4   RHO:16*1/128NM THETA:16*360/2^16deg
5  042 4   X:s16*1/64NM Y:s16*1/64NM
6  200 4   GSP:16*1/2^14NM/s HDG:16*360/2^16deg
7  070 2   V:1 G:1 L:1 _1 MODE3A:12
8  090 2   V:1 G:1 HGT:s14*1/4FL
9  141 2   141:16*1/128s
10 130 1+  130:7 /
11 131 1   131:s8*1dBm
12 120 1   120:s8*1/256NM/s
13 170 1+  CON:1 RAD:1 MAN:1 DOU:1 RDPC:1 _1 GHO:1 / TRE:1 _6 /
14 210 1+  210:7 /
15 050 2   V:1 G:1 L:1 _1 MODE2:12
16 080 2   _4 QA4:1 QA2:1 QA1:1 QB4:1 QB2:1 QB1:1 QC4:1 QC2:1 QC1:1 QD4:1 QD2:1 QD1:1
17 100 4   V:1 G:1 _2 MODEC:12 _4 QC1:1 QA1:1 QC2:1 QA2:1 QC4:1 QA4:1 QB1:1 QD1:1 QB2:1 QD2:1 QB4:1 QD4:1
18 060 2   _4 QA4:1 QA2:1 QA1:1 QB4:1 QB2:1 QB1:1 QC4:1 QC2:1 QC1:1 QD4:1 QD2:1 QD1:1
19 030 1+  030:7 /
20 SP  L
21 RFS R
22 150 1   XA:1 _1 XC:1 _2 X2:1 _2
"""

_CAT002 = """
1  010 2   SAC:8 SIC:8
2  000 1   000:8
3  020 1   020:8*360/2^8deg
4  030 3   030:24*1/128s
5  041 2   041:16*1/128s
6  050 1+  050:7 /
7  060 1+  060:7 /
8  070 *2  A:1 IDENT:5 COUNTER:10
9  100 8   RS:16*1/128NM RE:16*1/128NM TS:16*360/2^16deg TE:16*360/2^16deg
10 090 2   RE:s8*1/128NM AE:s8*360/2^14deg
11 080 1+  080:7 /
13 SP  L
14 RFS R
"""

_CAT010 = """
1  010 2   SAC:8 SIC:8
2  000 1   000:8
3  020 1+  TYP:3 DCR:1 CHN:1 GBS:1 CRT:1 / SIM:1 TST:1 RAB:1 LOP:2 TOT:2 / SPI:1 _6 /
4  140 3   140:24*1/128s
5  041 8   LAT:s32*180/2^31deg LON:s32*180/2^31deg
6  040 4   RHO:16*1m TH:16*360/2^16deg
7  042 4   X:s16*1m Y:s16*1m
8  200 4   GSP:16*1/2^14NM/s TRA:16*360/2^16deg
9  202 4   VX:s16*1/4m/s VY:s16*1/4m/s
10 161 2   _4 TRK:12
11 170 1+  CNF:1 TRE:1 CST:2 MAH:1 TCC:1 STH:1 / TOM:2 DOU:3 MRS:2 / GHO:1 _6 /
12 060 2   V:1 G:1 L:1 _1 MODE3A:12
13 220 3   220:24
14 245 7   STI:2 _6 CHR:a48
15 250 *8  MBDATA:56 BDS1:4 BDS2:4
16 300 1   300:8
17 090 2   V:1 G:1 FL:s14*1/4FL
18 091 2   091:s16*25/4ft
19 270 1+  LENGTH:7*1m / ORIENTATION:7*360/128deg / WIDTH:7*1m /
20 550 1   NOGO:2 OVL:1 TSV:1 DIV:1 TTF:1 _2
21 310 1   TRB:1 MSG:7
22 500 4   DEVX:8*1/4m DEVY:8*1/4m COVXY:s16*1/4m
23 280 *2  DRHO:s8*1m DTHETA:s8*0.15deg
24 131 1   131:8
25 210 2   AX:s8*1/4m/s2 AY:s8*1/4m/s2
27 SP  L
28 RE  L
"""

_CAT019 = """
1  010 2   SAC:8 SIC:8
2  000 1   000:8
3  140 3   140:24*1/128s
4  550 1   NOGO:2 OVL:1 TSV:1 TTF:1 _3
5  551 1   TP1A:1 TP1B:1 TP2A:1 TP2B:1 TP3A:1 TP3B:1 TP4A:1 TP4B:1
6  552 *2  RSI:8 _1 RS1090:1 TX1030:1 TX1090:1 RSS:1 RSO:1 _2
7  553 1+  REFTR1:2 _2 REFTR2:2 _1 / REFTR3:2 _2 REFTR4:2 _1 /
8  600 8   LAT:s32*180/2^30deg LON:s32*180/2^30deg
9  610 2   610:s16*1/4m
10 620 1   620:s8*1m
13 RE  L
14 SP  L
"""

_CAT020 = """
1  010 2   SAC:8 SIC:8
2  020 1+  SSR:1 MS:1 HF:1 VDL4:1 UAT:1 DME:1 OT:1 / RAB:1 SPI:1 CHN:1 GBS:1 CRT:1 SIM:1 TST:1 / CF:2 _5 /
3  140 3   140:24*1/128s
4  041 8   LAT:s32*180/2^25deg LON:s32*180/2^25deg
5  042 6   X:s24*1/2m Y:s24*1/2m
6  161 2   _4 TRN:12
7  170 1+  CNF:1 TRE:1 CST:1 CDM:2 MAH:1 STH:1 / GHO:1 _6 /
8  070 2   V:1 G:1 L:1 _1 MODE3A:12
9  202 4   VX:s16*1/4m/s VY:s16*1/4m/s
10 090 2   V:1 G:1 FL:s14*1/4FL
11 100 4   V:1 G:1 _2 MODEC:12 _4 QC1:1 QA1:1 QC2:1 QA2:1 QC4:1 QA4:1 QB1:1 QD1:1 QB2:1 QD2:1 QB4:1 QD4:1
12 220 3   220:24
13 245 7   STI:2 _6 CHR:a48
14 110 2   110:s16*25/4ft
15 105 2   105:s16*25/4ft
16 210 2   AX:s8*1/4m/s2 AY:s8*1/4m/s2
17 300 1   300:8
18 310 1   TRB:1 MSG:7
19 500 {}
.  DOP 6   X:16*1/4 Y:16*1/4 XY:16*1/4
.  SDP 6   X:16*1/4m Y:16*1/4m XY:16*1/4
.  SDH 2   SDH:16*1/2m
20 400 *1  BIT1:1 BIT2:1 BIT3:1 BIT4:1 BIT5:1 BIT6:1 BIT7:1 BIT8:1
21 250 *8  BDSDATA:56 BDS1:4 BDS2:4
22 230 2   COM:3 STAT:3 CASEVN:2 MSSC:1 ARC:1 AIC:1 B1A:1 B1B:4
23 260 7   260:56
24 030 1+  030:7 /
25 055 1   V:1 G:1 L:1 MODE1:5
26 050 2   V:1 G:1 L:1 _1 MODE2:12
27 RE  L
28 SP  L
"""

# The intent and the meteorology are the same in all editions of category 021.
_INTENT = """
.  TIS 1+  NAV:1 NVB:1 _5 /
.  TID *15 TCA:1 NC:1 TCPN:6 ALT:s16*10ft LAT:s24*180/2^23deg LON:s24*180/2^23deg PT:4 TD:2 TRA:1 TOA:1 TOV:24*1s TTR:16*1/100NM
"""
_WEATHER = """
.  WS  2   WS:16*1kt
.  WD  2   WD:16*1deg
.  TMP 2   TMP:s16*1/4C
.  TRB 1   TRB:8
"""

_CAT021_0_23 = f"""
1  010 2   SAC:8 SIC:8
2  040 2   DCR:1 GBS:1 SIM:1 TST:1 RAB:1 SAA:1 SPI:1 _1 ATP:3 ARC:2 _3
3  030 3   030:24*1/128s
4  130 6   LAT:s24*180/2^23deg LON:s24*180/2^23deg
5  080 3   080:24
6  140 2   140:s16*25/4ft
7  090 2   AC:2 MN:2 DC:2 _6 PA:4
8  210 1   _3 DTI:1 MDS:1 UAT:1 VDL:1 OTR:1
9  230 2   230:s16*1/100deg
10 145 2   145:s16*1/4FL
11 150 2   IM:1 AS:15
12 151 2   151:16*1kt
13 152 2   152:16*360/2^16deg
14 155 2   155:s16*25/4ft/min
15 157 2   157:s16*25/4ft/min
16 160 4   GS:s16*1/2^14NM/s TA:16*360/2^16deg
17 165 1+  TI:2 _5 / ROT:s7*1/4deg/s /
18 170 6   170:a48
19 095 1   095:8
20 032 1   032:8*1/256s
21 200 1   200:8
22 020 1   020:8
23 220 {{}}{_WEATHER}
24 146 2   SAS:1 SRC:2 ALT:s13*25ft
25 148 2   MV:1 AH:1 AM:1 ALT:s13*25ft
26 110 {{}}{_INTENT}
34 RE  L
35 SP  L
"""

_CAT021_2 = f"""
1  010 2   SAC:8 SIC:8
2  040 1+  ATP:3 ARC:2 RC:1 RAB:1 / DCR:1 GBS:1 SIM:1 TST:1 SAA:1 CL:2 / \\
           _1 LLC:1 IPC:1 NOGO:1 CPR:1 LDPJ:1 RCF:1 / TBC_EP:1 TBC_VAL:6 / MBC_EP:1 MBC_VAL:6 /
3  161 2   _4 TRNUM:12
4  015 1   015:8
5  071 3   071:24*1/128s
6  130 6   LAT:s24*180/2^23deg LON:s24*180/2^23deg
7  131 8   LAT:s32*180/2^30deg LON:s32*180/2^30deg
8  072 3   072:24*1/128s
9  150 2   IM:1 AS:15
10 151 2   RE:1 TAS:15*1kt
11 080 3   080:24
12 073 3   073:24*1/128s
13 074 4   FSI:2 TOMRP:30*1/2^30s
14 075 3   075:24*1/128s
15 076 4   FSI:2 TOMRP:30*1/2^30s
16 140 2   140:s16*25/4ft
17 090 1+  NUCRNACV:3 NUCPNIC:4 / NICBARO:1 SIL:2 NACP:4 / \\
           _2 SILS:1 SDA:2 GVA:2 / PIC:4 SRC:1 _2 / \\
           _2 VALSTATE_EP:1 VALSTATE_VAL:2 VD:1 VQ:1 / \\
           VALDISTP1:7*128m / VALDISTP2:7*1m / VALDISTQUALP1:7*128m / VALDISTQUALP2:7*1m /
18 210 1   _1 VNS:1 VN:3 LTT:3
19 070 2   _4 MODE3A:12
20 230 2   230:s16*1/100deg
21 145 2   145:s16*1/4FL
22 152 2   152:16*360/2^16deg
23 200 1   ICF:1 LNAV:1 ME:1 PS:3 SS:2
24 155 2   RE:1 BVR:s15*25/4ft/min
25 157 2   RE:1 GVR:s15*25/4ft/min
26 160 4   RE:1 GS:15*1/2^14NM/s TA:16*360/2^16deg
27 165 2   _6 TAR:s10*1/32deg/s
28 077 3   077:24*1/128s
29 170 6   170:a48
30 020 1   020:8
31 220 {{}}{_WEATHER}
32 146 2   SAS:1 S:2 ALT:s13*25ft
33 148 2   MV:1 AH:1 AM:1 ALT:s13*25ft
34 110 {{}}{_INTENT}
35 016 1   016:8*1/2s
36 008 1   RA:1 TC:2 TS:1 ARV:1 CDTIA:1 NOTTCAS:1 SA:1
37 271 1+  _2 POA:1 CDTIS:1 B2LOW:1 RAS:1 IDENT:1 / LW:4 _3 /
38 132 1   132:s8*1dBm
39 250 *8  250:64
40 260 7   TYP:5 STYP:3 ARA:14 RAC:4 RAT:1 MTE:1 TTI:2 TID:26
41 400 1   400:8
42 295 {{}}
.  AOS 1   AOS:8*1/10s
.  TRD 1   TRD:8*1/10s
.  M3A 1   M3A:8*1/10s
.  QI  1   QI:8*1/10s
.  TI1 1   TI1:8*1/10s
.  MAM 1   MAM:8*1/10s
.  GH  1   GH:8*1/10s
.  FL  1   FL:8*1/10s
.  SAL 1   SAL:8*1/10s
.  FSA 1   FSA:8*1/10s
.  AS  1   AS:8*1/10s
.  TAS 1   TAS:8*1/10s
.  MH  1   MH:8*1/10s
.  BVR 1   BVR:8*1/10s
.  GVR 1   GVR:8*1/10s
.  GV  1   GV:8*1/10s
.  TAR 1   TAR:8*1/10s
.  TI2 1   TI2:8*1/10s
.  TS  1   TS:8*1/10s
.  MET 1   MET:8*1/10s
.  ROA 1   ROA:8*1/10s
.  ARA 1   ARA:8*1/10s
.  SCC 1   SCC:8*1/10s
48 RE  L
49 SP  L
"""

_CAT034 = """
1  010 2   SAC:8 SIC:8
2  000 1   000:8
3  030 3   030:24*1/128s
4  020 1   020:8*360/2^8deg
5  041 2   041:16*1/128s
6  050 {}
.  COM 1   NOGO:1 RDPC:1 RDPR:1 OVLRDP:1 OVLXMT:1 MSC:1 TSV:1 _1
.  -
.  -
.  PSR 1   ANT:1 CHAB:2 OVL:1 MSC:1 _3
.  SSR 1   ANT:1 CHAB:2 OVL:1 MSC:1 _3
.  MDS 2   ANT:1 CHAB:2 OVLSUR:1 MSC:1 SCF:1 DLF:1 OVLSCF:1 OVLDLF:1 _7
7  060 {}
.  COM 1   _1 REDRDP:3 REDXMT:3 _1
.  -
.  -
.  PSR 1   POL:1 REDRAD:3 STC:2 _2
.  SSR 1   REDRAD:3 _5
.  MDS 1   REDRAD:3 CLU:1 _4
8  070 *2  TYP:5 COUNT:11
9  100 8   RHOST:16*1/256NM RHOEND:16*1/256NM THETAST:16*360/2^16deg THETAEND:16*360/2^16deg
10 110 1   110:8
11 120 8   HGT:s16*1m LAT:s24*180/2^23deg LON:s24*180/2^23deg
12 090 2   RNG:s8*1/128NM AZM:s8*360/2^14deg
13 RE  L
14 SP  L
"""

_CAT048 = """
1  010 2   SAC:8 SIC:8
2  140 3   140:24*1/128s
3  020 1+  TYP:3 SIM:1 RDP:1 SPI:1 RAB:1 / TST:1 ERR:1 XPP:1 ME:1 MI:1 FOEFRI:2 / \\
           ADSB_EP:1 ADSB_VAL:1 SCN_EP:1 SCN_VAL:1 PAI_EP:1 PAI_VAL:1 _1 / \\
           ACASXV_EP:1 ACASXV_VAL:4 POXPR_EP:1 POXPR_VAL:1 / \\
           POACT_EP:1 POACT_VAL:1 DTFXPR_EP:1 DTFXPR_VAL:1 DTFACT_EP:1 DTFACT_VAL:1 _1 / \\
           IRMXPR_EP:1 IRMXPR_VAL:1 IRMACT_EP:1 IRMACT_VAL:1 _3 /
4  040 4   RHO:16*1/256NM THETA:16*360/2^16deg
5  070 2   V:1 G:1 L:1 _1 MODE3A:12
6  090 2   V:1 G:1 FL:s14*1/4FL
7  130 {}
.  SRL 1   SRL:8*360/2^13deg
.  SRR 1   SRR:8
.  SAM 1   SAM:s8*1dBm
.  PRL 1   PRL:8*360/2^13deg
.  PAM 1   PAM:s8*1dBm
.  RPD 1   RPD:s8*1/256NM
.  APD 1   APD:s8*360/2^14deg
8  220 3   220:24
9  240 6   240:a48
10 250 *8  MBDATA:56 BDS1:4 BDS2:4
11 161 2   _4 TRN:12
12 042 4   X:s16*1/128NM Y:s16*1/128NM
13 200 4   GSP:16*1/2^14NM/s HDG:16*360/2^16deg
14 170 1+  CNF:1 RAD:2 DOU:1 MAH:1 CDM:2 / TRE:1 GHO:1 SUP:1 TCC:1 _3 /
15 210 4   SIGX:8*1/128NM SIGY:8*1/128NM SIGV:8*1/2^14NM/s SIGH:8*360/2^12deg
16 030 1+  030:7 /
17 080 2   _4 QA4:1 QA2:1 QA1:1 QB4:1 QB2:1 QB1:1 QC4:1 QC2:1 QC1:1 QD4:1 QD2:1 QD1:1
18 100 4   V:1 G:1 _2 MODEC:12 _4 QC1:1 QA1:1 QC2:1 QA2:1 QC4:1 QA4:1 QB1:1 QD1:1 QB2:1 QD2:1 QB4:1 QD4:1
19 110 2   _2 3DH:s14*25ft
20 120 {}
.  CAL 2   D:1 _5 CAL:s10*1m/s
.  RDS *6  DOP:16*1m/s AMB:16*1m/s FRQ:16*1MHz
21 230 2   COM:3 STAT:3 SI:1 _1 MSSC:1 ARC:1 AIC:1 B1A:1 B1B:4
22 260 7   260:56
23 055 1   V:1 G:1 L:1 MODE1:5
24 050 2   V:1 G:1 L:1 _1 MODE2:12
25 065 1   _3 QA4:1 QA2:1 QA1:1 QB2:1 QB1:1
26 060 2   _4 QA4:1 QA2:1 QA1:1 QB4:1 QB2:1 QB1:1 QC4:1 QC2:1 QC1:1 QD4:1 QD2:1 QD1:1
27 SP  L
28 RE  L
"""

_CAT062 = """
1  010 2   SAC:8 SIC:8
3  015 1   015:8
4  070 3   070:24*1/128s
5  105 8   LAT:s32*180/2^25deg LON:s32*180/2^25deg
6  100 6   X:s24*1/2m Y:s24*1/2m
7  185 4   VX:s16*1/4m/s VY:s16*1/4m/s
8  210 2   AX:s8*1/4m/s2 AY:s8*1/4m/s2
9  060 2   V:1 G:1 CH:1 _1 MODE3A:12
10 245 7   STI:2 _6 CHR:a48
11 380 {}
.  ADR 3   ADR:24
.  ID  6   ID:a48
.  MHG 2   MHG:16*360/2^16deg
.  IAS 2   IM:1 IAS:15
.  TAS 2   TAS:16*1kt
.  SAL 2   SAS:1 SRC:2 ALT:s13*25ft
.  FSS 2   MV:1 AH:1 AM:1 ALT:s13*25ft
.  TIS 1+  NAV:1 NVB:1 _5 /
.  TID *15 TCA:1 NC:1 TCPN:6 ALT:s16*10ft LAT:s24*180/2^23deg LON:s24*180/2^23deg PT:4 TD:2 TRA:1 TOA:1 TOV:24*1s TTR:16*1/100NM
.  COM 2   COM:3 STAT:3 _2 SSC:1 ARC:1 AIC:1 B1A:1 B1B:4
.  SAB 2   AC:2 MN:2 DC:2 GBS:1 _6 STAT:3
.  ACS 7   ACS:56
.  BVR 2   BVR:s16*25/4ft/min
.  GVR 2   GVR:s16*25/4ft/min
.  RAN 2   RAN:s16*1/100deg
.  TAR 2   TI:2 _6 ROT:s7*1/4deg/s _1
.  TAN 2   TAN:16*360/2^16deg
.  GS  2   GS:s16*1/2^14NM/s
.  VUN 1   VUN:8
.  MET 8   WS:1 WD:1 TMP:1 TRB:1 _4 WSD:16*1kt WDD:16*1deg TMPD:s16*1/4C TRBD:8
.  EMC 1   EMC:8
.  POS 6   LAT:s24*180/2^23deg LON:s24*180/2^23deg
.  GAL 2   GAL:s16*25/4ft
.  PUN 1   _4 PUN:4
.  BDSDATA *8 BDSDATA:64
.  IAR 2   IAR:16*1kt
.  MAC 2   MAC:16*1/125Mach
.  BPS 2   _4 BPS:12*1/10mb
12 040 2   040:16
13 080 1+  MON:1 SPI:1 MRH:1 SRC:3 CNF:1 / SIM:1 TSE:1 TSB:1 FPC:1 AFF:1 STP:1 KOS:1 / \\
           AMA:1 MD4:2 ME:1 MI:1 MD5:2 / CST:1 PSR:1 SSR:1 MDS:1 ADS:1 SUC:1 AAC:1 / \\
           SDS:2 EMS:3 PFT:1 FPLT:1 / DUPT:1 DUPF:1 DUPM:1 SFC:1 IDD:1 IEC:1 MLAT:1 / M5I:1 _6 /
14 290 {}
.  TRK 1   TRK:8*1/4s
.  PSR 1   PSR:8*1/4s
.  SSR 1   SSR:8*1/4s
.  MDS 1   MDS:8*1/4s
.  ADS 2   ADS:16*1/4s
.  ES  1   ES:8*1/4s
.  VDL 1   VDL:8*1/4s
.  UAT 1   UAT:8*1/4s
.  LOP 1   LOP:8*1/4s
.  MLT 1   MLT:8*1/4s
15 200 1   TRANS:2 LONG:2 VERT:2 ADF:1 _1
16 295 {}
.  MFL 1   MFL:8*1/4s
.  MD1 1   MD1:8*1/4s
.  MD2 1   MD2:8*1/4s
.  MDA 1   MDA:8*1/4s
.  MD4 1   MD4:8*1/4s
.  MD5 1   MD5:8*1/4s
.  MHG 1   MHG:8*1/4s
.  IAS 1   IAS:8*1/4s
.  TAS 1   TAS:8*1/4s
.  SAL 1   SAL:8*1/4s
.  FSS 1   FSS:8*1/4s
.  TID 1   TID:8*1/4s
.  COM 1   COM:8*1/4s
.  SAB 1   SAB:8*1/4s
.  ACS 1   ACS:8*1/4s
.  BVR 1   BVR:8*1/4s
.  GVR 1   GVR:8*1/4s
.  RAN 1   RAN:8*1/4s
.  TAR 1   TAR:8*1/4s
.  TAN 1   TAN:8*1/4s
.  GSP 1   GSP:8*1/4s
.  VUN 1   VUN:8*1/4s
.  MET 1   MET:8*1/4s
.  EMC 1   EMC:8*1/4s
.  POS 1   POS:8*1/4s
.  GAL 1   GAL:8*1/4s
.  PUN 1   PUN:8*1/4s
.  MB  1   MB:8*1/4s
.  IAR 1   IAR:8*1/4s
.  MAC 1   MAC:8*1/4s
.  BPS 1   BPS:8*1/4s
17 136 2   136:s16*1/4FL
18 130 2   130:s16*25/4ft
19 135 2   QNH:1 CTB:s15*1/4FL
20 220 2   220:s16*25/4ft/min
21 390 {}
.  TAG 2   SAC:8 SIC:8
.  CS  7   CS:56
.  IFI 4   TYP:2 _3 NBR:27
.  FCT 1   GATOAT:2 FR1FR2:2 RVSM:2 HPR:1 _1
.  TAC 4   TAC:32
.  WTC 1   WTC:8
.  DEP 4   DEP:32
.  DST 4   DST:32
.  RDS 3   NU1:8 NU2:8 LTR:8
.  CFL 2   CFL:16*1/4FL
.  CTL 2   CENTRE:8 POSITION:8
.  TOD *4  TYP:5 DAY:2 _4 HOR:5 _2 MIN:6 AVS:1 _1 SEC:6
.  AST 6   AST:48
.  STS 1   EMP:2 AVL:2 _4
.  STD 7   STD:56
.  STA 7   STA:56
.  PEM 2   _3 VA:1 MODE3A:12
.  PEC 7   PEC:56
22 270 1+  LENGTH:7*1m / ORIENTATION:7*360/128deg / WIDTH:7*1m /
23 300 1   300:8
24 110 {}
.  SUM 1   M5:1 ID:1 DA:1 M1:1 M2:1 M3:1 MC:1 X:1
.  PMN 4   _2 PIN:14 _3 NAT:5 _2 MIS:6
.  POS 6   LAT:s24*180/2^23deg LON:s24*180/2^23deg
.  GA  2   _1 RES:1 GA:s14*25ft
.  EM1 2   _4 EM1:12
.  TOS 1   TOS:s8*1/128s
.  XP  1   _3 X5:1 XC:1 X3:1 X2:1 X1:1
25 120 2   _4 MODE2:12
26 510 3+3 IDENT:8 TRACK:15 /
27 500 {}
.  APC 4   X:16*1/2m Y:16*1/2m
.  COV 2   COV:s16*1/2m
.  APW 4   LAT:16*180/2^25deg LON:16*180/2^25deg
.  AGA 1   AGA:8*25/4ft
.  ABA 1   ABA:8*1/4FL
.  ATV 2   X:8*1/4m/s Y:8*1/4m/s
.  AA  2   X:8*1/4m/s2 Y:8*1/4m/s2
.  ARC 1   ARC:8*25/4ft/min
28 340 {}
.  SID 2   SAC:8 SIC:8
.  POS 4   RHO:16*1/256NM THETA:16*360/2^16deg
.  HEIGHT 2 HEIGHT:s16*25ft
.  MDC 2   V:1 G:1 LMC:s14*1/4FL
.  MDA 2   V:1 G:1 L:1 _1 MODE3A:12
.  TYP 1   TYP:3 SIM:1 RAB:1 TST:1 _2
34 RE  L
35 SP  L
"""

# The draft that systems of the first decade of this century send; item 050 is known by its place only.
_CAT062_0_17 = """
1  010 2   SAC:8 SIC:8
2  015 1   015:8
3  070 3   070:24*1/128s
4  040 2   _1 040:15
5  105 6   LAT:s24*180/2^23deg LON:s24*180/2^23deg
6  100 4   X:s16*1/64NM Y:s16*1/64NM
7  060 2   _4 MODE3A:12
8  130 2   130:s16*25/4ft
9  135 2   QNH:1 CTB:s15*1/4FL
10 136 2   136:s16*1/4FL
11 180 4   GSP:16*1/2^14NM/s HDG:16*360/2^16deg
12 200 1   TRANS:2 LONG:2 VERT:2 _2
13 220 2   220:s16*25/4ft/min
14 240 1   240:s8*1/4deg/s
15 210 2   210:s16*0.00044155m/s2
16 080 1+  MON:1 SPI:1 MRH:1 SRC:3 CNF:1 / SIM:1 TSE:1 TSB:1 FPC:1 _3 / AMA:1 MD4:2 ME:1 MI:1 _2 / \\
           CST:1 PSR:1 SSR:1 MDS:1 ADS:1 SUC:1 AAC:1 /
17 290 {}
.  PSR 1   PSR:8*1/4s
.  SSR 1   SSR:8*1/4s
.  MDA 1   MDA:8*1/4s
.  MFL 1   MFL:8*1/4s
.  MDS 1   MDS:8*1/4s
.  ADS 2   ADS:16*1/4s
.  ES  1   ES:8*1/4s
.  MD1 1   MD1:8*1/4s
.  MD2 1   MD2:8*1/4s
18 340 {}
.  SID 2   SAC:8 SIC:8
.  POS 4   RHO:16*1/256NM THETA:16*360/2^16deg
.  HEIGHT 2 HEIGHT:s16*25ft
.  MDC 2   V:1 G:1 LMC:s14*1/4FL
.  MDA 2   V:1 G:1 L:1 _1 MODE3A:12
.  TYP 1   TYP:3 SIM:1 RAB:1 TST:1 _2
19 380 {}
.  BDSDATA *8 BDSDATA:64
.  ADR 3   ADR:24
.  ID  6   ID:a48
.  COM 2   COM:3 STAT:3 _2 SSC:1 ARC:1 AIC:1 B1A:1 B1B:4
.  ACS 7   ACS:56
21 390 {}
.  TAG 2   SAC:8 SIC:8
.  CS  7   CS:56
.  IFI 4   TYP:2 _3 NBR:27
.  FCT 1   GATOAT:2 FR1FR2:2 RVSM:2 HPR:1 _1
.  TAC 4   TAC:32
.  WTC 1   WTC:8
.  DEP 4   DEP:32
.  DST 4   DST:32
.  RDS 3   NU1:8 NU2:8 LTR:8
.  CFL 2   CFL:16*1/4FL
.  CTL 2   CENTRE:8 POSITION:8
.  TOD *4  TYP:5 DAY:2 _4 HOR:5 _2 MIN:6 AVS:1 _1 SEC:6
.  AST 6   AST:48
.  STS 1   EMP:2 AVL:2 _4
22 110 1   _3 MODE1:5
23 120 2   _4 MODE2:12
24 510 3+3 IDENT:8 TRACK:15 /
27 RE  L
28 SP  L
"""

_CAT063 = """
1  010 2   SAC:8 SIC:8
2  015 1   015:8
3  030 3   030:24*1/128s
4  050 2   SAC:8 SIC:8
5  060 1+  CON:2 PSR:1 SSR:1 MDS:1 ADS:1 MLT:1 / OPS:1 ODP:1 OXT:1 MSC:1 TSV:1 NPW:1 _1 / \\
           TTF_EP:1 TTF_VAL:1 SPO_EP:1 SPO_VAL:1 _3 /
6  070 2   070:s16*1ms
7  080 4   SRG:s16*1/10^5 SRB:s16*1/128NM
8  081 2   081:s16*360/2^16deg
9  090 4   PRG:s16*1/10^5 PRB:s16*1/128NM
10 091 2   091:s16*360/2^16deg
11 092 2   092:s16*360/2^16deg
13 RE  L
14 SP  L
"""

_CAT065 = """
1  010 2   SAC:8 SIC:8
2  000 1   000:8
3  015 1   015:8
4  030 3   030:24*1/128s
5  020 1   020:8
6  040 1   NOGO:2 OVL:1 TSV:1 PSS:2 STTN:1 _1
7  050 1   050:8
13 RE  L
14 SP  L
"""

# The tables by category and edition: a text, or the edition that it changes and the lines that replace those with the same FRN.
# An "x" stands for editions that only append to each other: what is new in them lies in extensions or spare bits.
_TABLES: dict[int, dict[str, tuple[str, ...]]] = {
    1: {"1.x": (_CAT001,)},
    2: {"1.x": (_CAT002,)},
    10: {"1.1": (_CAT010,)},
    19: {"1.3": (_CAT019,)},
    20: {"1.x": (_CAT020,)},
    21: {
        "2.x": (_CAT021_2,),
        "2.1": (_CAT021_2, "37 271 1?1 _2 POA:1 CDTIS:1 B2LOW:1 RAS:1 IDENT:1 / _4 LW:4"),
        "0.23": (_CAT021_0_23,),
        "0.25": (_CAT021_0_23, "4 130 8 LAT:s32*180/2^25deg LON:s32*180/2^25deg"),
        "0.26": (
            _CAT021_0_23,
            "4 130 8 LAT:s32*180/2^25deg LON:s32*180/2^25deg",
            "27 070 2 V:1 G:1 L:1 _1 MODE3A:12",
            "28 131 1 131:8",
        ),
    },
    34: {"1.x": (_CAT034,)},
    48: {"1.x": (_CAT048,)},
    62: {"1.x": (_CAT062,), "0.17": (_CAT062_0_17,)},
    63: {"1.x": (_CAT063,)},
    65: {"1.x": (_CAT065,)},
}

# Categories with a second list of items: where the first bit of item 020 is set, a record has that of the number on the right.
# That number stands for a category of its own wherever columns are asked for; it is not one that a block can have.
SECOND: dict[int, int] = {1: 256}
_SECOND_TABLES: dict[int, dict[str, tuple[str, ...]]] = {256: {"1.x": (_CAT001_TRACK,)}}

# Published editions that have the table of another one.
_SAME = {
    (20, f"1.{n}"): "1.x" for n in range(0, 12)
} | {(21, f"2.{n}"): "2.x" for n in range(2, 8)} | {(21, "0.24"): "0.25"} | {(34, f"1.{n}"): "1.x" for n in range(20, 30)} | {
    (48, f"1.{n}"): "1.x" for n in range(14, 33)
} | {(19, f"1.{n}"): "1.3" for n in range(0, 4)} | {
    (c, f"1.{n}"): "1.x" for c, editions in {1: range(2, 5), 2: range(3), 62: range(16, 22), 63: (6, 7), 65: range(4, 7)}.items()
    for n in editions
}  # fmt: skip

# What is tried where the edition of a category is not given, the likeliest first.  Other categories have one table.
INFERRED: dict[int, tuple[str, ...]] = {21: ("2.x", "0.23", "0.26"), 62: ("1.x", "0.17")}


class Field(NamedTuple):
    """Bits of an item, `bit` from its first; a `scaled` one is worth `lsb` of `unit`; `part` is that of an extended item."""

    name: str
    bit: int
    bits: int
    signed: bool
    text: bool
    scaled: bool
    lsb: float
    unit: str
    part: int


class Item(NamedTuple):
    """One item: its kind, the size of its first part (or a repetition), the step of its extensions, at most so many (0: any)."""

    name: str
    kind: int
    size: int
    step: int
    most: int
    fields: tuple[Field, ...]
    subitems: tuple[Item | None, ...]


UNDEFINED, FIXED, EXTENDED, REPETITIVE, EXPLICIT, COMPOUND, RANDOM = range(7)


def _number(text: str) -> float:
    above, _, below = text.partition("/")
    value = float(above)
    if below:
        base, _, power = below.partition("^")
        value /= float(base) ** int(power or 1)
    return value


_FIELD = re.compile(r"^(\w+):([sa]?)(\d+)(?:\*(\d[\d.]*(?:/\d+(?:\^\d+)?)?)(\S*))?$")


def _fields(words: list[str], kind: int) -> tuple[Field, ...]:
    out: list[Field] = []
    at = part = 0
    for word in words:
        if word == "/":
            at, part = at + 1, part + 1
        elif word.startswith("_"):
            at += int(word[1:])
        else:
            match = _FIELD.match(word)
            if match is None or (match[5] or "") not in SI:
                raise ValueError(f"no field of a category table: {word!r}")
            bits = int(match[3])
            out.append(
                Field(
                    match[1],
                    at,
                    bits,
                    match[2] == "s",
                    match[2] == "a",
                    match[4] is not None,
                    _number(match[4] or "1"),
                    match[5] or "",
                    part,
                )
            )
            at += bits
    if kind != EXPLICIT and at % 8:
        raise ValueError(f"the fields {' '.join(words)!r} do not fill bytes")
    return tuple(out)


def _item(words: list[str]) -> Item | None:
    name = words[0]
    if name == "-":
        return None
    structure, rest = words[1], words[2:]
    size = step = most = 0
    if structure == "L":
        kind = EXPLICIT
    elif structure == "R":
        kind = RANDOM
    elif structure == "{}":
        kind = COMPOUND
    elif structure[0] == "*":
        kind, size = REPETITIVE, int(structure[1:])
    elif "+" in structure or "?" in structure:
        first, mark, more = re.split(r"([+?])", structure)
        kind, size, step, most = EXTENDED, int(first), int(more or 1), int(mark == "?")
    else:
        kind, size = FIXED, int(structure)
    return Item(name, kind, size, step, most, _fields(rest, kind), ())


def _parse(texts: tuple[str, ...]) -> tuple[Item | None, ...]:
    items: dict[int, Item | None] = {}
    frn = 0
    for line in "\n".join(texts).replace("\\\n", " ").splitlines():
        words = line.split()
        if not words:
            continue
        item = _item(words[1:])
        if words[0] == ".":
            owner = items[frn]
            assert owner is not None
            items[frn] = owner._replace(subitems=(*owner.subitems, item))
        else:
            frn = int(words[0])
            items[frn] = item
    return tuple(items.get(n) for n in range(1, max(items) + 1))


def categories() -> tuple[int, ...]:
    """The categories that can be read."""
    return tuple(_TABLES)


def table_of(category: int, edition: str) -> str:
    """The name of the table that serves an edition of a category ("2.4" of 021 has that of "2.x").

    Raises SettingsError, naming the editions that are known, for others.
    """
    name = _SAME.get((category, edition), edition)
    if category not in _TABLES:
        known = ", ".join(f"{c:03d}" for c in _TABLES)
        why = f"ASTERIX category {category:03d} cannot be read"
        raise SettingsError(why, where="edition", remedy=f"Known categories: {known}.")
    if name not in _TABLES[category]:
        known = ", ".join([*_TABLES[category], *(e for c, e in _SAME if c == category)])
        why = f"edition {edition!r} of ASTERIX category {category:03d} is unknown"
        raise SettingsError(why, where="edition", remedy=f"Known editions: {known}.")
    return name


def default_edition(category: int) -> str:
    """The edition that a category is read as where nothing else is said."""
    return next(iter(_TABLES[category]))


@cache
def items_of(category: int, edition: str) -> tuple[Item | None, ...]:
    """The items of a category in the order of its FSPEC bits; None where a bit has no item."""
    if category in _SECOND_TABLES:
        return _parse(_SECOND_TABLES[category][edition])
    return _parse(_TABLES[category][table_of(category, edition)])


# ---------------------------------------------------------------------------------------------------------------- columns
# Where each column of Plots and Fixes comes from: "ITEM.FIELD", or "ITEM/SUBITEM.FIELD"; " unless V G" leaves the column absent
# where one of these bits of the item is set ("clipped": where the value stands at the end of its range); " | " gives the next
# choice where the first is absent.  Names that are no columns (speed, course, vx …) are combined in `asterix`.


class Columns(NamedTuple):
    """What a category gives: `needs` is the item that makes a record a row, `time` the items that hold its time of day."""

    needs: tuple[str, ...]
    columns: dict[str, str]


_TRANSPONDER = "unless V G"
_DAMAGED_CODE = Flag.GARBLED

_CAT001_PLOT = {
    "range_m": "040.RHO",
    "azimuth_rad": "040.THETA",
    "pressure_altitude_m": f"090.HGT {_TRANSPONDER}",
    "mode_3a": f"070.MODE3A {_TRANSPONDER}",
}

PLOTS: dict[int, Columns] = {
    1: Columns(("040",), _CAT001_PLOT),
    256: Columns(("040",), {**_CAT001_PLOT, "track": "161.161", "speed": "200.GSP", "course": "200.HDG"}),
    10: Columns(
        ("040",),
        {
            "range_m": "040.RHO",
            "azimuth_rad": "040.TH",
            "height_m": "091.091",
            "pressure_altitude_m": f"090.FL {_TRANSPONDER}",
            "mode_s": "220.220",
            "mode_3a": f"060.MODE3A {_TRANSPONDER}",
            "callsign": "245.CHR",
            "track": "161.TRK",
            "length_m": "270.LENGTH",
            "width_m": "270.WIDTH",
            "orientation": "270.ORIENTATION",
            "speed": "200.GSP",
            "course": "200.TRA",
            "vx": "202.VX",
            "vy": "202.VY",
        },
    ),
    48: Columns(
        ("040",),
        {
            "range_m": "040.RHO",
            "azimuth_rad": "040.THETA",
            "height_m": "110.3DH",
            "pressure_altitude_m": f"090.FL {_TRANSPONDER}",
            "mode_s": "220.220",
            "mode_3a": f"070.MODE3A {_TRANSPONDER}",
            "callsign": "240.240",
            "track": "161.TRN",
            "psr_ssr_range_m": "130/RPD.RPD",
            "psr_ssr_azimuth_rad": "130/APD.APD",
            "speed": "200.GSP",
            "course": "200.HDG",
        },
    ),
}

FIXES: dict[tuple[int, str], Columns] = {
    (256, ""): Columns(
        ("042",),
        {
            "x_m": "042.X unless clipped",
            "y_m": "042.Y unless clipped",
            "pressure_altitude_m": f"090.HGT {_TRANSPONDER}",
            "mode_3a": f"070.MODE3A {_TRANSPONDER}",
            "track": "161.161",
            "speed": "200.GSP",
            "course": "200.HDG",
        },
    ),
    (10, ""): Columns(
        ("041", "042"),
        {
            "latitude_rad": "041.LAT",
            "longitude_rad": "041.LON",
            "x_m": "042.X unless clipped",
            "y_m": "042.Y unless clipped",
            "height_m": "091.091",
            "pressure_altitude_m": f"090.FL {_TRANSPONDER}",
            "mode_s": "220.220",
            "mode_3a": f"060.MODE3A {_TRANSPONDER}",
            "callsign": "245.CHR",
            "track": "161.TRK",
            "length_m": "270.LENGTH",
            "width_m": "270.WIDTH",
            "orientation": "270.ORIENTATION",
            "speed": "200.GSP",
            "course": "200.TRA",
            "vx": "202.VX",
            "vy": "202.VY",
            "sd_x": "500.DEVX",
            "sd_y": "500.DEVY",
        },
    ),
    (20, ""): Columns(
        ("041", "042"),
        {
            "latitude_rad": "041.LAT",
            "longitude_rad": "041.LON",
            "x_m": "042.X unless clipped",
            "y_m": "042.Y unless clipped",
            "height_m": "105.105",
            "pressure_altitude_m": f"090.FL {_TRANSPONDER}",
            "mode_s": "220.220",
            "mode_3a": f"070.MODE3A {_TRANSPONDER}",
            "callsign": "245.CHR",
            "track": "161.TRN",
            "vx": "202.VX",
            "vy": "202.VY",
            "sd_x": "500/SDP.X",
            "sd_y": "500/SDP.Y",
            "vertical_sd_m": "500/SDH.SDH",
        },
    ),
    (21, "0"): Columns(
        ("130",),
        {
            "latitude_rad": "130.LAT",
            "longitude_rad": "130.LON",
            "height_m": "140.140 unless clipped",
            "pressure_altitude_m": "145.145",
            "mode_s": "080.080",
            "callsign": "170.170",
            "speed": "160.GS",
            "course": "160.TA",
            "velocity_up_mps": "157.157 | 155.155",
            "time_bound": "032.032",
        },
    ),
    (21, "2"): Columns(
        ("131", "130"),
        {
            "latitude_rad": "131.LAT | 130.LAT",
            "longitude_rad": "131.LON | 130.LON",
            "height_m": "140.140 unless clipped",
            "pressure_altitude_m": "145.145",
            "mode_s": "080.080",
            "mode_3a": "070.MODE3A",
            "callsign": "170.170",
            "track": "161.TRNUM",
            "speed": "160.GS",
            "course": "160.TA",
            "velocity_up_mps": "157.GVR unless RE | 155.BVR unless RE",
            "nacp": "090.NACP",
            "gva": "090.GVA",
            "version": "210.VN",
            "length_width": "271.LW",
        },
    ),
    (48, ""): Columns(
        ("042",),
        {
            "x_m": "042.X unless clipped",
            "y_m": "042.Y unless clipped",
            "pressure_altitude_m": f"090.FL {_TRANSPONDER}",
            "mode_s": "220.220",
            "mode_3a": f"070.MODE3A {_TRANSPONDER}",
            "callsign": "240.240",
            "track": "161.TRN",
            "speed": "200.GSP",
            "course": "200.HDG",
            "sd_x": "210.SIGX",
            "sd_y": "210.SIGY",
        },
    ),
}

# States of tracks.  The ages are those of the kinds of measurement that may have gone in: the youngest one counts.
AGES = ("PSR", "SSR", "MDS", "ADS", "ES", "VDL", "UAT", "LOP", "MLT")
TRACKS: dict[tuple[int, str], Columns] = {
    (62, "0"): Columns(
        ("040",),
        {
            "track": "040.040",
            "latitude_rad": "105.LAT",
            "longitude_rad": "105.LON",
            "x_m": "100.X unless clipped",
            "y_m": "100.Y unless clipped",
            "height_m": "130.130",
            "pressure_altitude_m": "136.136 | 135.CTB unless QNH",
            "speed": "180.GSP",
            "course": "180.HDG",
            "velocity_up_mps": "220.220",
            "mode_s": "380/ADR.ADR",
            "mode_3a": "060.MODE3A",
            "callsign": "380/ID.ID",
            "flight": "390/CS.CS",
            **{f"age_{name}": f"290/{name}.{name}" for name in ("PSR", "SSR", "MDS", "ADS", "ES")},
        },
    ),
    (62, ""): Columns(
        ("040",),
        {
            "track": "040.040",
            "latitude_rad": "105.LAT",
            "longitude_rad": "105.LON",
            "x_m": "100.X unless clipped",
            "y_m": "100.Y unless clipped",
            "height_m": "130.130",
            "pressure_altitude_m": "136.136 | 135.CTB unless QNH",
            "velocity_east_mps": "185.VX",
            "velocity_north_mps": "185.VY",
            "velocity_up_mps": "220.220",
            "acceleration_east_mps2": "210.AX",
            "acceleration_north_mps2": "210.AY",
            "mode_s": "380/ADR.ADR",
            "mode_3a": f"060.MODE3A {_TRANSPONDER}",
            "callsign": "380/ID.ID | 245.CHR",
            "flight": "390/CS.CS",
            "length_m": "270.LENGTH",
            "width_m": "270.WIDTH",
            "heading_rad": "270.ORIENTATION",
            "sd_x": "500/APC.X",
            "sd_y": "500/APC.Y",
            "sd_latitude": "500/APW.LAT",
            "sd_longitude": "500/APW.LON",
            "vertical_sd_m": "500/AGA.AGA",
            **{f"age_{name}": f"290/{name}.{name}" for name in AGES},
        },
    ),
}

# Marks of the antenna's turn: the kind of message, the azimuth of a sector, the period of rotation.
MARKS: dict[int, tuple[str, str, str]] = {
    2: ("000.000", "020.020", "041.041"),
    34: ("000.000", "020.020", "041.041"),
}
NORTH_MARK, SECTOR_MARK, SOUTH_MARK = 1, 2, 3

# What a tracking system says of its sensors' errors: the item, its name, the unit to tell it in, and what one SI unit is there.
SENSOR_STATUS: dict[int, tuple[tuple[str, str, str, float], ...]] = {
    63: (
        ("070.070", "time", "ms", 1e3),
        ("080.SRG", "SSR range gain", "m/km", 1e3),
        ("080.SRB", "SSR range", "m", 1.0),
        ("081.081", "SSR azimuth", "deg", 57.29577951308232),
        ("090.PRG", "PSR range gain", "m/km", 1e3),
        ("090.PRB", "PSR range", "m", 1.0),
        ("091.091", "PSR azimuth", "deg", 57.29577951308232),
        ("092.092", "PSR elevation", "deg", 57.29577951308232),
    ),
}
STATUS_OF = {63: ("050.SAC", "050.SIC", "060.CON")}

# The columns that are codes (integers); all others are quantities.
CODES = frozenset({"flight", "mode_s", "mode_3a", "callsign", "track", "nacp", "gva", "version", "length_width"})

# Time of day: the first item that a record has; the second name is the high-precision fraction that goes with it.
TIMES: dict[tuple[int, str], tuple[tuple[str, str], ...]] = {
    (1, ""): (("141.141", ""),),
    (256, ""): (("141.141", ""),),
    (2, ""): (("030.030", ""),),
    (62, ""): (("070.070", ""),),
    (62, "0"): (("070.070", ""),),
    (63, ""): (("030.030", ""),),
    (65, ""): (("030.030", ""),),
    (10, ""): (("140.140", ""),),
    (19, ""): (("140.140", ""),),
    (20, ""): (("140.140", ""),),
    (21, "0"): (("030.030", ""),),
    (21, "2"): (("071.071", ""), ("073.073", "074"), ("077.077", "")),
    (34, ""): (("030.030", ""),),
    (48, ""): (("140.140", ""),),
}

# Categories whose time of day is cut to its low 16 bits: it begins anew every 512 s (and at midnight).
TRUNCATED_S: dict[int, float] = {1: 512.0}

# Flags: the field, its values (none: any but zero; a list item is looked through), and what they mean.
_REPLY_WARNINGS: tuple[tuple[str, tuple[int, ...], Flag], ...] = (
    ("030.030", (1, 10), Flag.REFLECTION),
    ("030.030", (2,), Flag.SIDE_LOBE),
    ("030.030", (4,), Flag.SECOND_TIME),
    ("030.030", (6,), Flag.VEHICLE),
)
_CAT001_FLAGS: tuple[tuple[str, tuple[int, ...], Flag], ...] = (
    ("020.SIM", (), Flag.SIMULATED),
    ("020.TST", (), Flag.TEST),
    ("020.RAB", (), Flag.FIELD_MONITOR),
    ("020.SSRPSR", (0,), Flag.EXTRAPOLATED),
    ("070.G", (), _DAMAGED_CODE),
    ("090.G", (), _DAMAGED_CODE),
    ("030.030", (1,), Flag.GARBLED),
    ("030.030", (2, 66), Flag.REFLECTION),
    ("030.030", (3,), Flag.SIDE_LOBE),
    ("030.030", (5,), Flag.SECOND_TIME),
    ("030.030", (7,), Flag.VEHICLE),
)
FLAGS: dict[tuple[int, str], tuple[tuple[str, tuple[int, ...], Flag], ...]] = {
    (1, ""): _CAT001_FLAGS,
    (256, ""): (*_CAT001_FLAGS, ("170.GHO", (), Flag.REFLECTION), ("170.TRE", (), Flag.TRACK_END)),
    (62, "0"): (
        ("080.SIM", (), Flag.SIMULATED),
        ("080.TSE", (), Flag.TRACK_END),
        ("080.CST", (), Flag.EXTRAPOLATED),
    ),
    (62, ""): (
        ("080.SIM", (), Flag.SIMULATED),
        ("080.TSE", (), Flag.TRACK_END),
        ("080.CST", (), Flag.EXTRAPOLATED),
        ("080.SFC", (), Flag.GROUND),
        ("060.G", (), _DAMAGED_CODE),
    ),
    (10, ""): (
        ("020.SIM", (), Flag.SIMULATED),
        ("020.TST", (), Flag.TEST),
        ("020.RAB", (), Flag.FIELD_MONITOR),
        ("020.GBS", (), Flag.GROUND),
        ("020.TOT", (2,), Flag.VEHICLE),
        ("060.G", (), _DAMAGED_CODE),
        ("090.G", (), _DAMAGED_CODE),
        ("170.CST", (), Flag.EXTRAPOLATED),
        ("170.TRE", (), Flag.TRACK_END),
        ("170.GHO", (), Flag.REFLECTION),
        ("300.300", tuple(range(256)), Flag.VEHICLE),
    ),
    (20, ""): (
        ("020.SIM", (), Flag.SIMULATED),
        ("020.TST", (), Flag.TEST),
        ("020.RAB", (), Flag.FIELD_MONITOR),
        ("020.GBS", (), Flag.GROUND),
        ("070.G", (), _DAMAGED_CODE),
        ("090.G", (), _DAMAGED_CODE),
        ("170.CST", (), Flag.EXTRAPOLATED),
        ("170.TRE", (), Flag.TRACK_END),
        ("170.GHO", (), Flag.REFLECTION),
        ("300.300", tuple(range(256)), Flag.VEHICLE),
        *_REPLY_WARNINGS,
    ),
    (21, "0"): (
        ("040.SIM", (), Flag.SIMULATED),
        ("040.TST", (), Flag.TEST),
        ("040.RAB", (), Flag.FIELD_MONITOR),
        ("040.GBS", (), Flag.GROUND),
        ("020.020", (20, 21, 22), Flag.VEHICLE),
    ),
    (21, "2"): (
        ("040.SIM", (), Flag.SIMULATED),
        ("040.TST", (), Flag.TEST),
        ("040.RAB", (), Flag.FIELD_MONITOR),
        ("040.GBS", (), Flag.GROUND),
        ("020.020", (20, 21, 22, 23, 24), Flag.VEHICLE),
    ),
    (48, ""): (
        ("020.SIM", (), Flag.SIMULATED),
        ("020.TST", (), Flag.TEST),
        ("020.RAB", (), Flag.FIELD_MONITOR),
        ("020.RDP", (), Flag.CHAIN_2),
        ("020.TYP", (0,), Flag.EXTRAPOLATED),
        ("230.STAT", (1, 3), Flag.GROUND),
        ("070.G", (), _DAMAGED_CODE),
        ("090.G", (), _DAMAGED_CODE),
        ("170.TRE", (), Flag.TRACK_END),
        ("170.GHO", (), Flag.REFLECTION),
        *_REPLY_WARNINGS,
    ),
}

# Which chain measured: the field whose value is looked up, or none where the category says it.
_CAT001_CHANNELS = ("020.SSRPSR", (Channel.UNKNOWN, Channel.PSR, Channel.SSR, Channel.SSR_PSR))
CHANNELS: dict[int, tuple[str, tuple[Channel, ...]]] = {
    1: _CAT001_CHANNELS,
    256: _CAT001_CHANNELS,
    62: ("", (Channel.UNKNOWN,)),
    10: (
        "020.TYP",
        (
            Channel.MLAT,
            Channel.MLAT,
            Channel.ADS_B,
            Channel.PSR,
            Channel.UNKNOWN,
            Channel.MLAT,
            Channel.UNKNOWN,
            Channel.UNKNOWN,
        ),
    ),
    20: ("", (Channel.MLAT,)),
    21: ("", (Channel.ADS_B,)),
    48: (
        "020.TYP",
        (
            Channel.UNKNOWN,
            Channel.PSR,
            Channel.SSR,
            Channel.SSR_PSR,
            Channel.MODE_S,
            Channel.MODE_S,
            Channel.MODE_S_PSR,
            Channel.MODE_S_PSR,
        ),
    ),
}

# Where the stream tells its own position: latitude, longitude, height.
SITES: dict[int, tuple[str, str, str]] = {
    19: ("600.LAT", "600.LON", "610.610"),
    34: ("120.LAT", "120.LON", "120.HGT"),
}


def family(category: int, edition: str) -> str:
    """The part of an edition that decides where columns come from: "0" or "2" of category 021, "0" of 062, else nothing."""
    if category == 62:
        return "0" if edition[0] == "0" else ""
    return edition[0] if category == 21 else ""


# EPU (95 %, m) by NACp: DO-260B table 2-71; half of all radial errors of a circular normal lie within, sd per axis = EPU / 2.448.
EPU_M = (float("nan"), 18520.0, 7408.0, 3704.0, 1852.0, 926.0, 555.6, 185.2, 92.6, 30.0, 10.0, 3.0)
# Vertical accuracy (95 %, m) by GVA: only 1 and 2 promise anything.
GVA_M = (float("nan"), 150.0, 45.0, float("nan"))
# Length and width (m) by the ADS-B code: the middle of each class of length, and its largest width; 0 says nothing.
LENGTH_M = (float("nan"), 12.0, 20.0, 20.0, 30.0, 30.0, 40.0, 40.0, 50.0, 50.0, 60.0, 60.0, 70.0, 70.0, 80.0, 80.0)
WIDTH_M = (float("nan"), 23.0, 28.5, 34.0, 33.0, 38.0, 39.5, 45.0, 45.0, 52.0, 59.5, 67.0, 72.5, 80.0, 80.0, 90.0)


def editions_of(category: int) -> tuple[str, ...]:
    """The tables that a category has."""
    return tuple(_TABLES[category])
