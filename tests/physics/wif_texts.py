"""Weaving Information Files in the manner of the programs that write them."""

FLOOR_LOOM = """[WIF]
Version=1.1
Date=April 20, 1997
Source Program=A floor loom's

[CONTENTS]
WEAVING=true
WARP=true
WEFT=true
THREADING=true
TIEUP=true
TREADLING=true
COLOR PALETTE=true
COLOR TABLE=true
WARP COLORS=true

[TEXT]
Title=Twill; or so = it says

[WEAVING]
Shafts=4
Treadles=6
Rising Shed=true

[WARP]
Threads=8
Color=2
Units=Inches
Spacing=0.05
Thickness=0.04

[WEFT]
Threads=4
Color=1
Units=Inches
Spacing=0.1

[COLOR PALETTE]
Entries=2
Form=RGB
Range=0,255

[COLOR TABLE]
1=255,255,255
2=0,51,102  ; indigo

[WARP COLORS]
3=1

[WARP SPACING]
2=0.075

[THREADING]
1=1
2=2
3=3
4=4
5=1
6=2
7=3
8=4

[TIEUP]
1=1,2
2=2,3
3=3,4
4=4,1
5=
6=0

[TREADLING]
1=4
2=3
3=2
4=1
"""

DOBBY = """; written by a program for dobby looms
[wif]
version=1.1
[contents]
threading=1
tieup=0
treadling=0
liftplan=1
[Weaving]
shafts=4
treadles=0
rising shed=yes
[warp]
threads=4   ; one repeat
units=centimeters
spacing=0,212
[weft]
threads=4
units=Decipoints
spacing=72
thickness=36
[threading]
4=4
3=3
2=2
1=1
[tieup]
[treadling]
[liftplan]
1=1,4
2=3,4
3=2,3
4=1,2
[PRIVATE DOBBY NOTES]
this is not = a line of ours
nor this
[notes]
1=; text
"""

SINKING = """[WIF]
Version=1.1
[WEAVING]
Shafts=2
Treadles=2
Rising Shed=off
[WARP]
Threads=2
[WEFT]
Threads=2
[THREADING]
1=1
2=2
[TIEUP]
1=1
2=2
[TREADLING]
1=1
2=2
"""
