#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#define SMAJAX_REAL float
#include "controller.h"

static void put(char c) {
    while (!(UCSR0A & _BV(UDRE0))) {
    }
    UDR0 = c;
}

static void print(long number) {
    char digits[12];
    unsigned char n = 0;
    if (number < 0) {
        put('-');
        number = -number;
    }
    do {
        digits[n++] = (char)('0' + number % 10);
        number /= 10;
    } while (number);
    while (n)
        put(digits[--n]);
}

int main(void) {
    smajax_state s;
    unsigned most = 0;
    int k;
    UCSR0B = _BV(TXEN0);
    TCCR1B = _BV(CS10);
    smajax_reset(&s, SMAJAX_START, 0);
    for (k = 0; k < 100; k++) {
        volatile float value = 4e-5f * (float)k, command;
        unsigned cycles;
        TCNT1 = 0;
        command = smajax_step(&s, 3e-3f, value);
        cycles = TCNT1;
        most = cycles > most ? cycles : most;
        print((long)(1e6f * command));
        put(' ');
    }
    print((long)most);
    put('\n');
    cli();
    sleep_enable();
    sleep_cpu();
    return 0;
}
