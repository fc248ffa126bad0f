/* Localizes a robot with the filter in lab.h, which is made by
 *     Path("lab.h").write_text(jaxcell.automata.to_c_header(filter, name="lab"))
 * Reads observations, characters 0 and 1; prints the colour at the start and after each of them. */
#include <stdio.h>

#include "lab.h"

int main(void) {
    lab_state state = LAB_START;
    int character;
    printf("%lu\n", (unsigned long)lab_color(state));
    while ((character = getchar()) == '0' || character == '1') {
        state = lab_next(state, (uint8_t)(character - '0'));
        printf("%lu\n", (unsigned long)lab_color(state));
    }
    if (lab_refuted(state)) return 1;
    if (lab_localized(state))
        fprintf(stderr, "in one of %lu configurations\n", (unsigned long)lab_uncertainty(state));
    return 0;
}
